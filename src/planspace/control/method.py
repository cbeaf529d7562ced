"""The seam of control: how sampled controls become better ones. See docs/howto/own-method.md."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

PAGE = "docs/control.md"
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
