"""An embedding's encoder as a JAX function."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float32, Num

from planspace.embed.embedding import Embedding
from planspace.embed.float32_encoder import float32_encoder
from planspace.embed.mlp import forward
from planspace.physics.quaternion import rotation_columns

States = Num[Array, "*batch state"] | Num[np.ndarray, "*batch state"]


def jax_function(
    embedding: Embedding,
) -> Callable[[States], Float32[Array, "*batch z"]]:
    """Make a pure function that computes z from states in JAX: `Embedding.encode` in float32.

    It works under `jax.jit`, `jax.vmap` and `jax.grad`, on the device of the states.

    Args:
        embedding: the embedding; its decoder is not used. Its weights are constants of the function.

    Returns:
        The function. It maps states [..., state] to z [..., z]. It raises a `PlanspaceError` if the
        states have the wrong number of columns.
    """
    arrays = float32_encoder(embedding)
    layers = [(weight.T, bias) for weight, bias in (*arrays.hidden, arrays.mu)]

    def encode(states: States) -> Float32[Array, "*batch z"]:
        x = jnp.asarray(states, jnp.float32)
        embedding.inputs.check_shape(x.shape)
        if arrays.circular.size or arrays.quaternions.size:
            angles = x[..., arrays.circular]
            rotations = rotation_columns(*(x[..., columns] for columns in arrays.quaternions))
            parts = (x[..., arrays.straight], jnp.sin(angles), jnp.cos(angles), *rotations)
            x = jnp.concatenate(parts, axis=-1)
        with jax.default_matmul_precision("float32"):  # GPUs and TPUs would round the factors
            return forward(layers, x - arrays.mean, jax.nn.relu)

    return encode
