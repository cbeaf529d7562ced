"""The network of policies and critics."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

from planspace.rl.stack import VARIANCE_FLOOR, Activation


class MLP(eqx.Module):
    """Tanh or ReLU layers and a linear output; Glorot-uniform weights, zero biases.

    With `layer_norm`, the inputs of each activation are brought to mean 0 and standard deviation 1 over the
    units of the layer, without gain or bias (Ba et al. 2016).
    """

    weights: list[Float[Array, "out in"]]
    biases: list[Float[Array, " out"]]
    layer_norm: bool = eqx.field(static=True)
    activation: Activation = eqx.field(static=True)

    def __init__(
        self,
        sizes: tuple[int, ...],
        *,
        layer_norm: bool = False,
        activation: Activation = "tanh",
        key: Key[Array, ""],
    ):
        """Draw weights for layers of these sizes, starting with the inputs."""
        keys = jr.split(key, len(sizes) - 1)
        init = jax.nn.initializers.glorot_uniform(in_axis=1, out_axis=0)
        self.weights = [init(k, (b, a)) for k, a, b in zip(keys, sizes[:-1], sizes[1:], strict=True)]
        self.biases = [jnp.zeros(b) for b in sizes[1:]]
        self.layer_norm, self.activation = layer_norm, activation

    def __call__(self, x: Float[Array, " in"]) -> Float[Array, " out"]:
        """The output for one input.

        This is `embed.mlp.forward`, except that XLA rounds `weight @ x` and `x @ weight.T` differently, and
        policies must not depend on the version that trained them.
        """
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = weight @ x + bias
            if self.layer_norm:
                x = (x - x.mean()) / jnp.sqrt(x.var() + VARIANCE_FLOOR)
            x = jax.nn.relu(x) if self.activation == "relu" else jnp.tanh(x)
        return self.weights[-1] @ x + self.biases[-1]
