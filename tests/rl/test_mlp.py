import jax
import jax.random as jr
import numpy as np

from planspace.rl.mlp import MLP
from planspace.rl.stack import stacked


def test_layer_norm_is_the_same_in_numpy(rng: np.random.Generator) -> None:
    plain, normed = (
        [MLP((3, 16, 16, 2), layer_norm=n, key=key) for key in jr.split(jr.key(0), 2)] for n in (False, True)
    )
    x = rng.normal(size=(2, 5, 3)).astype(np.float32)
    for networks in (plain, normed):
        wanted = [jax.vmap(network)(rows) for network, rows in zip(networks, x, strict=True)]
        np.testing.assert_allclose(stacked(networks)(x), wanted, atol=1e-5)
    assert np.abs(stacked(plain)(x) - stacked(normed)(x)).max() > 0.01
