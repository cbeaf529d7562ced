"""The seam for objectives: what an embedding is trained to minimise, and on which samples.

`planspace.embed.objectives` has the shipped ones, one per file. Users can pass their own instead. This
module imports no JAX, so that `--help` answers at once: the methods import it.
"""

import inspect
import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from planspace.embed.triplet_source import Triplets, TripletSource
from planspace.errors import UsageError, check_setting, quoted
from planspace.seams import check_fits, name_of

if TYPE_CHECKING:
    from jax import Array

    from planspace.embed.embedding import Embedding
    from planspace.embed.inputs import Inputs
    from planspace.embed.networks import PlanSpaceModel
    from planspace.embed.samples import Sample
else:  # importing their modules would import JAX
    Array = PlanSpaceModel = Sample = Embedding = Inputs = Any

PAGE = "docs/howto/own-objective.md"
"""The page that explains how to write an objective."""

Key = Any
"""A JAX random key."""
Loss = Any
"""A scalar to be minimised, or a pair of it and its named terms, which the training log shows."""


@runtime_checkable
class Objective(Protocol):
    """What an embedding is trained on. Only `loss` has no default.

    An implementation is a frozen dataclass: its fields are its settings. Either derive it from this class,
    which gives it the defaults below, or write all four methods.
    """

    @abstractmethod
    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """Compute the loss of one sample, in JAX.

        If the loss does not depend on `model.decode`, training adds a term that fits the decoder to z, with
        no gradient to the encoder. So every embedding can decode z, and has a decoded error.

        Args:
            model: encoder and decoder: `model.encode(x)` is q(z|x) and `model.decode(z)` is p(x|z), each a
                Gaussian with `mu`, `sigma`, `sample(key=...)` and `log_prob(x)`.
            sample: three states of a demonstration, see `Sample`. There is no batch axis.
            key: a JAX random key for this sample.

        Returns:
            A scalar to be minimised; or a pair of it and its terms by name, which go to the training log.
        """
        ...

    def draw_triplets(self, source: TripletSource) -> Triplets:
        """Choose the triplets of states to train on; by default as the settings say."""
        return source.standard()

    def needs_controls(self) -> bool:
        """Whether samples contain the demonstrations' controls, and the model a transition; by default no."""
        return False

    def closed_form(
        self, inputs: Inputs, states: Float[np.ndarray, "row state"], z_dim: int
    ) -> Embedding | None:
        """Compute the embedding without training, if that is possible; by default it is not.

        Args:
            inputs: what the encoder sees of a state.
            states: the training states.
            z_dim: the numbers in z.

        Returns:
            The embedding, or None if it has to be trained.
        """
        return None


@dataclass(frozen=True)
class FunctionObjective(Objective):
    """An objective made of a user's function `loss(model, sample, *, key)`, with default sampling."""

    name: ClassVar[str] = "function"

    function: Callable[..., Loss]
    """The function; see `Objective.loss`."""

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """Call the function."""
        return self.function(model, sample, key=key)


def as_objective(given: Any) -> Objective:
    """Return a user's object or function as an `Objective`.

    Args:
        given: an objective, or a function `loss(model, sample, *, key)`.

    Raises:
        UsageError: a method or an argument is missing, a class was given instead of an object, or the object
            cannot be hashed.
    """
    if inspect.isroutine(given):
        _check_arguments(given)
        return FunctionObjective(given)
    objective = check_fits(given, Objective, PAGE)
    _check_arguments(objective.loss)
    try:
        hash(objective)
    except TypeError as error:
        raise UsageError(
            f"an Objective must be hashable, got {quoted(objective)}: make it a frozen dataclass. See {PAGE}."
        ) from error
    return objective


def title_of(objective: Objective) -> str:
    """The name of an objective; for a function, where it is defined."""
    return name_of(objective.function if isinstance(objective, FunctionObjective) else objective)


def summary_of(objective: Objective) -> str:
    """The first line of an objective's docstring."""
    written = objective.function if isinstance(objective, FunctionObjective) else type(objective)
    return (inspect.getdoc(written) or "").partition("\n")[0]


def check_weights(**weights: float) -> None:
    """Check the weights of an objective's terms.

    Raises:
        UsageError: a weight is negative or not finite.
    """
    for name, weight in weights.items():
        check_setting(name, weight, 0 <= weight < math.inf, "at least 0 and finite")


def split_loss(found: Loss) -> tuple[Array, Mapping[str, Array]]:
    """Separate what `Objective.loss` returned into the loss and its terms.

    Raises:
        UsageError: it is not a scalar, nor a pair of a scalar and named scalars.
    """
    loss: Any = found
    terms: Any = {}
    if isinstance(found, tuple) and len(found) == 2:
        loss, terms = found
    if not _is_scalar(loss):
        raise _misfit("a scalar, or a pair of a scalar and its terms by name", loss)
    if not isinstance(terms, Mapping):
        raise _misfit("the terms as a dict", terms)
    for name, term in terms.items():
        if not _is_scalar(term):
            raise _misfit(f"a scalar for the term {name!r}", term)
    return loss, terms


def _is_scalar(value: Any) -> bool:
    return isinstance(value, int | float) or getattr(value, "shape", None) == ()


def _misfit(wanted: str, got: Any) -> UsageError:
    shape = getattr(got, "shape", None)
    shown = quoted(got) if shape is None else f"an array of shape {tuple(shape)}"
    return UsageError(f"the method `loss` of an Objective must return {wanted}, got {shown}. See {PAGE}.")


def _check_arguments(loss: Callable[..., Any]) -> None:
    try:
        inspect.signature(loss).bind(None, None, key=None)
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"the loss of an Objective is called as loss(model, sample, key=key); {quoted(loss)} does not "
            f"accept that: {error}. See {PAGE}."
        ) from error
