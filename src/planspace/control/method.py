"""The seam of control: how sampled controls become better ones. See docs/howto/own-method.md."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from planspace.errors import UsageError, quoted
from planspace.seams import name_of

PAGE = "docs/howto/own-method.md"
"""The page that explains the protocol."""


@runtime_checkable
class Method(Protocol):
    """How candidates and their costs become the next distribution of controls.

    Controls are the values of spline knots, in halves of their range. An implementation is a frozen dataclass
    whose fields are its settings. It may also have `iterations`, the number of rounds for each control step,
    by default 1.
    """

    def improve(
        self,
        std: Float[np.ndarray, "knot control"],
        candidates: Float[np.ndarray, "sample knot control"],
        costs: Float[np.ndarray, " sample"],
    ) -> tuple[Float[np.ndarray, "knot control"], Float[np.ndarray, "knot control"]]:
        """Return the mean and the standard deviation of the next round.

        Args:
            std: the standard deviation that the candidates were drawn with.
            candidates: the knots that were simulated; the first is the mean of this round, without noise.
            costs: the cost of each; infinite if physics diverged.
        """
        ...


def improved(
    method: Method,
    std: Float[np.ndarray, "knot control"],
    candidates: Float[np.ndarray, "sample knot control"],
    costs: Float[np.ndarray, " sample"],
) -> tuple[Float[np.ndarray, "knot control"], Float[np.ndarray, "knot control"]]:
    """Call a method, and check what it returns.

    Raises:
        UsageError: it returned something that does not fit the protocol `Method`.
    """
    found = method.improve(std, candidates, costs)
    if not isinstance(found, tuple) or len(found) != 2:
        raise _misfit(method, "a mean and a standard deviation", quoted(found))
    mean, spread = (
        _checked(method, name, value, std.shape) for name, value in zip(("mean", "std"), found, strict=True)
    )
    if (spread < 0).any():
        raise _misfit(method, "a standard deviation of at least 0", f"{spread.min():g}")
    return mean, spread


def _checked(method: Method, name: str, given: Any, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    wanted = f"a {name} of shape {shape}"
    try:
        numbers = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise _misfit(method, wanted, quoted(given)) from None
    if numbers.shape != shape:
        raise _misfit(method, wanted, f"shape {numbers.shape}")
    if not np.isfinite(numbers).all():
        raise _misfit(method, f"a finite {name}", f"{numbers[~np.isfinite(numbers)][0]}")
    return numbers


def _misfit(method: Method, wanted: str, got: str) -> UsageError:
    return UsageError(f"Method {name_of(method)}: improve() must return {wanted}, got {got}. See {PAGE}.")
