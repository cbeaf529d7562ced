"""A path through state space with the controls that lead along it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from planspace.demos.search_tree import SearchTree


class Trajectory(NamedTuple):
    """States and the controls between them."""

    states: Float[np.ndarray, "time state"]
    controls: Float[np.ndarray, "step control"]
    tree: SearchTree | None = None
    """The tree of the search that found the path."""
