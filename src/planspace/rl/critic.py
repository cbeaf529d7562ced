"""The linear-feature baseline of the 2020 runs: ridge regression of returns on simple features.

In NumPy and float64: with sin and cos among the observations the normal equations have condition 6e10.
"""

import numpy as np
from jaxtyping import Float, Int

RIDGE = 1e-5
OBS_BOUND = 10.0


def features(
    obs: Float[np.ndarray, "*batch obs"], step: Int[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch feature"]:
    """[clip(obs, -10, 10), its square, t/100, (t/100)^2, (t/100)^3, 1], t the step within the episode."""
    clipped = np.clip(obs.astype(np.float64), -OBS_BOUND, OBS_BOUND)
    t = step[..., None] / 100.0
    return np.concatenate([clipped, clipped**2, t, t**2, t**3, np.ones_like(t)], axis=-1)


def fit(
    x: Float[np.ndarray, "seed sample feature"], returns: Float[np.ndarray, "seed sample"]
) -> Float[np.ndarray, "seed feature"]:
    """Weights of the ridge regression of returns on features, for each seed."""
    transposed = x.transpose(0, 2, 1)
    normal = transposed @ x + RIDGE * np.eye(x.shape[-1])
    return np.linalg.solve(normal, transposed @ returns[..., None])[..., 0]
