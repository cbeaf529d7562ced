"""Arrays of NPZ archives."""

import numpy as np


def archive(num: int, length: int = 20) -> dict[str, np.ndarray]:
    """An archive with `num` demonstrations of `length` states."""
    rows = num * length
    return {
        "states": np.random.default_rng(0).normal(size=(rows, 3)),
        "controls": np.ones((rows, 1)),
        "time": np.tile(0.1 * np.arange(length), num),
        "offsets": np.arange(num + 1) * length,
    }
