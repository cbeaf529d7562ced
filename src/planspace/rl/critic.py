"""Critics, which predict the discounted return from an observation.

`LinearCritic` is the baseline of the 2020 TRPO runs; `MLPCritic` replaces that of their PPO runs. Both are
fitted to the discounted returns of each iteration, after the update of the policy.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from planspace.rl.algorithms.on_policy import CriticName
from planspace.rl.mlp import MLP
from planspace.rl.stack import stacked

RIDGE = 1e-5
OBS_BOUND = 10.0
MLP_EPOCHS, MLP_MINIBATCH, MLP_RATE = 10, 500, 1e-3
"""As many epochs as PPO has. The 2020 runs fitted their network by L-BFGS under a KL penalty."""


class LinearCritic(eqx.Module):
    """Ridge regression of returns on simple features, with zero weights at first.

    It uses float64, because the normal equations have a condition number of 6e10 when observations contain
    sin and cos.
    """

    weights: Float[np.ndarray, " feature"]

    def values(
        self, obs: Float[np.ndarray, "*batch obs"], step: Int[np.ndarray, "*batch"]
    ) -> Float[np.ndarray, "*batch"]:
        """Values of observations at these steps of their episodes."""
        return features(obs, step) @ self.weights

    def fitted(
        self,
        obs: Float[np.ndarray, "sample obs"],
        step: Int[np.ndarray, " sample"],
        returns: Float[np.ndarray, " sample"],
        *,
        key: Key[Array, ""],
    ) -> "LinearCritic":
        """The critic fitted to these returns."""
        return LinearCritic(ridge_regression(features(obs, step), returns))


class MLPCritic(eqx.Module):
    """A network of tanh layers, with standardised observations and a standardised output."""

    network: MLP
    obs_mean: Float[np.ndarray, " obs"]
    obs_std: Float[np.ndarray, " obs"]
    mean: Float[np.ndarray, ""]
    std: Float[np.ndarray, ""]

    def values(
        self, obs: Float[np.ndarray, "*batch obs"], step: Int[np.ndarray, "*batch"]
    ) -> Float[np.ndarray, "*batch"]:
        """Values of observations; the step is not used."""
        rows = self._inputs(obs).reshape(1, -1, obs.shape[-1])
        output = stacked([self.network])(rows).reshape(obs.shape[:-1]).astype(np.float64)
        return output * self.std + self.mean

    def fitted(
        self,
        obs: Float[np.ndarray, "sample obs"],
        step: Int[np.ndarray, " sample"],
        returns: Float[np.ndarray, " sample"],
        *,
        key: Key[Array, ""],
    ) -> "MLPCritic":
        """The critic fitted to these returns by Adam, starting from the present weights."""
        mean, std = np.asarray(returns.mean()), np.asarray(np.maximum(returns.std(), 1e-6))
        obs_mean = obs.mean(axis=0, dtype=float)
        obs_std = np.maximum(obs.std(axis=0, dtype=float), 1e-6)
        scaled = MLPCritic(self.network, obs_mean, obs_std, mean, std)
        targets = ((returns - mean) / std).astype(np.float32)
        network = _fit(self.network, scaled._inputs(obs), targets, key)
        return eqx.tree_at(lambda c: c.network, scaled, network)

    def _inputs(self, obs: np.ndarray) -> np.ndarray:
        return ((obs - self.obs_mean) / self.obs_std).astype(np.float32)


Critic = LinearCritic | MLPCritic


def make_critic(name: CriticName, num_obs: int, hidden: tuple[int, ...], *, key: Key[Array, ""]) -> Critic:
    """A critic before training.

    Args:
        name: `linear` or `mlp`.
        num_obs: numbers in an observation.
        hidden: units of the hidden layers of an `mlp` critic.
        key: random key of the first weights.
    """
    if name == "linear":
        num_features = features(np.zeros((1, num_obs)), np.zeros(1, int)).shape[1]
        return LinearCritic(np.zeros(num_features))
    network = MLP((num_obs, *hidden, 1), key=key)
    return MLPCritic(network, np.zeros(num_obs), np.ones(num_obs), np.zeros(()), np.zeros(()))


def features(
    obs: Float[np.ndarray, "*batch obs"], step: Int[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch feature"]:
    """[clip(obs, -10, 10), its square, t/100, (t/100)^2, (t/100)^3, 1], t the step within the episode."""
    clipped = np.clip(obs.astype(np.float64), -OBS_BOUND, OBS_BOUND)
    t = step[..., None] / 100.0
    return np.concatenate([clipped, clipped**2, t, t**2, t**3, np.ones_like(t)], axis=-1)


def ridge_regression(
    x: Float[np.ndarray, "sample feature"], returns: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, " feature"]:
    """Weights of the ridge regression of returns on features."""
    return np.linalg.solve(x.T @ x + RIDGE * np.eye(x.shape[1]), x.T @ returns)


@jax.jit
def _fit(
    network: MLP,
    inputs: Float[Array, "sample obs"],
    targets: Float[Array, " sample"],
    key: Key[Array, ""],
) -> MLP:
    """Least squares by Adam; an epoch leaves out the samples that do not fill a minibatch."""
    adam = optax.adam(MLP_RATE)
    size = min(MLP_MINIBATCH, len(targets))
    num = len(targets) // size

    def error(network: MLP, rows: Int[Array, " sample"]) -> Array:
        return jnp.mean((jax.vmap(network)(inputs[rows])[:, 0] - targets[rows]) ** 2)

    def step(carry: tuple, rows: Int[Array, " sample"]) -> tuple[tuple, None]:
        network, state = carry
        updates, state = adam.update(jax.grad(error)(network, rows), state)
        return (eqx.apply_updates(network, updates), state), None

    orders = jax.vmap(lambda k: jr.permutation(k, len(targets))[: num * size])(jr.split(key, MLP_EPOCHS))
    (network, _), _ = jax.lax.scan(
        step, (network, adam.init(eqx.filter(network, eqx.is_array))), orders.reshape(-1, size)
    )
    return network
