"""What a trace of an objective's loss says about it, before anything is compiled or trained."""

from typing import Any

import equinox as eqx
import jax

from planspace.embed.networks import PlanSpaceModel
from planspace.embed.objective import PAGE, Objective, split_loss, title_of
from planspace.errors import PlanspaceError, UsageError


def uses_decoder(objective: Objective, model: Any, sample: Any, key: Any) -> bool:
    """Whether the loss of a sample depends on the decoder.

    Args:
        objective: the objective.
        model: the model; only shapes matter.
        sample: a sample without batch axis; only shapes matter.
        key: a random key; only its shape matters.

    Returns:
        Whether it does. If the loss passes the decoder to a compiled function, the answer is yes.

    Raises:
        UsageError: the loss raises an exception, or does not return what `Objective.loss` requires.
    """
    model, sample, key = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype), (model, sample, key))

    def loss_of(decode: Any, model: PlanSpaceModel, sample: Any, key: Any) -> Any:
        model = eqx.tree_at(lambda m: m.decode, model, decode)
        return split_loss(objective.loss(model, sample, key=key))[0]

    try:
        jaxpr = jax.make_jaxpr(loss_of)(model.decode, model, sample, key).jaxpr
    except PlanspaceError:
        raise
    except Exception as error:  # whatever the user's code raises
        raise UsageError(
            f"the loss of the Objective {title_of(objective)} failed on its first sample: "
            f"{type(error).__name__}: {str(error).partition(chr(10))[0]} See {PAGE}."
        ) from error
    needed = _variables(jaxpr.outvars)
    for equation in reversed(jaxpr.eqns):
        if needed & _variables(equation.outvars):
            needed |= _variables(equation.invars)
    return bool(needed & _variables(jaxpr.invars[: len(jax.tree.leaves(model.decode))]))


def _variables(atoms: Any) -> set[Any]:
    return {atom for atom in atoms if not hasattr(atom, "val")}  # a literal has a value
