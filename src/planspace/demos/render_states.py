"""Draw the states of demonstrations as small pictures."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int, UInt8

from planspace.errors import UsageError
from planspace.physics.pictures import PictureConfig, Pictures
from planspace.progress import progress_over

if TYPE_CHECKING:
    from planspace.demos.dataset import Demos


def render_states(
    demos: "Demos", rows: Int[np.ndarray, " picture"] | None, config: PictureConfig | None, seed: int
) -> UInt8[np.ndarray, "picture height width 3"]:
    """Draw states; `Demos.render_states` describes the arguments.

    Raises:
        PlanspaceError: there is no model, or no OpenGL backend works here.
        UsageError: a row does not exist, or the model has no camera of this name.
    """
    config = config or PictureConfig()
    states = demos.states
    if rows is not None:
        rows = np.asarray(rows)
        if rows.ndim != 1 or rows.dtype.kind not in "iu" or (rows < 0).any() or (rows >= len(states)).any():
            raise UsageError(f"`rows` must be row numbers from 0 to {len(states) - 1}, got {rows}.")
        states = states[rows]
    pictures = Pictures(*demos.info.compile(), config)
    rng = np.random.default_rng(seed)
    found = np.empty((len(states), config.height, config.width, 3), dtype=np.uint8)
    for i in progress_over(range(len(states)), "render", unit="picture"):
        found[i] = pictures.of_states(states[i : i + 1], pictures.draw_look(rng))[0]
    pictures.close()
    return found
