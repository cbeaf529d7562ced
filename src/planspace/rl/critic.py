"""Critics: what is still to be earned from an observation on, for all seeds at once.

`LinearCritic` is the baseline of the 2020 TRPO runs, `MLPCritic` stands for that of their PPO runs. Both are
fitted anew, after the policy's update, to the discounted returns of the iteration.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from planspace.rl.config import CriticName
from planspace.rl.mlp import MLP, stacked

RIDGE = 1e-5
OBS_BOUND = 10.0
MLP_HIDDEN = (32, 32)
MLP_EPOCHS, MLP_MINIBATCH, MLP_RATE = 10, 500, 1e-3
"""The 2020 runs fitted theirs by L-BFGS under a KL penalty; ours takes as many passes as PPO does."""


class LinearCritic(eqx.Module):
    """Ridge regression of returns on simple features, zero at first.

    In NumPy and float64: with sin and cos among the observations the normal equations have condition 6e10.
    """

    weights: Float[np.ndarray, "seed feature"]

    def values(
        self, obs: Float[np.ndarray, "seed sample obs"], step: Int[np.ndarray, "seed sample"]
    ) -> Float[np.ndarray, "seed sample"]:
        """The values of observations at steps within their episodes."""
        return np.einsum("snf,sf->sn", features(obs, step), self.weights, optimize=True)

    def fitted(
        self,
        obs: Float[np.ndarray, "seed sample obs"],
        step: Int[np.ndarray, "seed sample"],
        returns: Float[np.ndarray, "seed sample"],
        keys: Key[Array, " seed"],
    ) -> "LinearCritic":
        """Fitted to these returns."""
        return LinearCritic(ridge_regression(features(obs, step), returns))


class MLPCritic(eqx.Module):
    """A network of 2 x 32 tanh units over standardised observations, its output standardised as well."""

    networks: MLP
    """One a seed."""
    obs_mean: Float[np.ndarray, "seed obs"]
    obs_deviation: Float[np.ndarray, "seed obs"]
    mean: Float[np.ndarray, " seed"]
    deviation: Float[np.ndarray, " seed"]

    def values(
        self, obs: Float[np.ndarray, "seed sample obs"], step: Int[np.ndarray, "seed sample"]
    ) -> Float[np.ndarray, "seed sample"]:
        """The values of observations; the step does not matter."""
        output = stacked(self.networks)(self._inputs(obs))[..., 0].astype(np.float64)
        return output * self.deviation[:, None] + self.mean[:, None]

    def fitted(
        self,
        obs: Float[np.ndarray, "seed sample obs"],
        step: Int[np.ndarray, "seed sample"],
        returns: Float[np.ndarray, "seed sample"],
        keys: Key[Array, " seed"],
    ) -> "MLPCritic":
        """Fitted to these returns by Adam, from where it stands."""
        scaled = MLPCritic(
            self.networks,
            obs.mean(axis=1),
            np.maximum(obs.std(axis=1), 1e-6),
            returns.mean(axis=1),
            np.maximum(returns.std(axis=1), 1e-6),
        )
        targets = (returns - scaled.mean[:, None]) / scaled.deviation[:, None]
        networks = _fit(
            self.networks, jnp.asarray(scaled._inputs(obs)), jnp.asarray(targets, jnp.float32), keys
        )
        return eqx.tree_at(lambda c: c.networks, scaled, networks)

    def _inputs(self, obs: np.ndarray) -> np.ndarray:
        return ((obs - self.obs_mean[:, None]) / self.obs_deviation[:, None]).astype(np.float32)


Critic = LinearCritic | MLPCritic


def make_critic(name: CriticName, num_obs: int, keys: Key[Array, " seed"]) -> Critic:
    """A critic that has seen nothing yet."""
    num = len(keys)
    if name == "linear":
        return LinearCritic(np.zeros((num, 2 * num_obs + 4)))
    networks = eqx.filter_vmap(lambda k: MLP((num_obs, *MLP_HIDDEN, 1), key=k))(keys)
    return MLPCritic(
        networks, np.zeros((num, num_obs)), np.ones((num, num_obs)), np.zeros(num), np.zeros(num)
    )


def features(
    obs: Float[np.ndarray, "*batch obs"], step: Int[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch feature"]:
    """[clip(obs, -10, 10), its square, t/100, (t/100)^2, (t/100)^3, 1], t the step within the episode."""
    clipped = np.clip(obs.astype(np.float64), -OBS_BOUND, OBS_BOUND)
    t = step[..., None] / 100.0
    return np.concatenate([clipped, clipped**2, t, t**2, t**3, np.ones_like(t)], axis=-1)


def ridge_regression(
    x: Float[np.ndarray, "seed sample feature"], returns: Float[np.ndarray, "seed sample"]
) -> Float[np.ndarray, "seed feature"]:
    """Weights of the ridge regression of returns on features, for each seed."""
    transposed = x.transpose(0, 2, 1)
    normal = transposed @ x + RIDGE * np.eye(x.shape[-1])
    return np.linalg.solve(normal, transposed @ returns[..., None])[..., 0]


@eqx.filter_jit
def _fit(
    networks: MLP,
    inputs: Float[Array, "seed sample obs"],
    targets: Float[Array, "seed sample"],
    keys: Key[Array, " seed"],
) -> MLP:
    return eqx.filter_vmap(_fit_one)(networks, inputs, targets, keys)


def _fit_one(
    network: MLP, inputs: Float[Array, "sample obs"], targets: Float[Array, " sample"], key: Key[Array, ""]
) -> MLP:
    """Least squares by Adam; samples beyond an epoch's last whole minibatch wait for the next epoch."""
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
