"""A stranger's algorithm: the cross-entropy method (Rubinstein 1999), with one network an episode."""

import itertools
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax.flatten_util import ravel_pytree

from planspace.rl.arm import Arm
from planspace.rl.mlp import MLP
from planspace.rl.policy_network import PolicyNetwork
from planspace.rl.rollout import Rollout
from planspace.rl.stack import Stack


@dataclass(frozen=True)
class CrossEntropy:
    """Draw parameters of policies, keep the best, and draw the next around them."""

    name: ClassVar[str] = "cross-entropy"

    units: tuple[int, ...] = (8,)
    """Units of the hidden layers."""
    elite: float = 0.3
    """Fraction of the policies of an iteration that is kept."""
    noise: float = 0.02
    """Standard deviation added to that of the kept policies."""

    def init(self, arm: Arm, *, key: Any) -> Any:
        """The mean and standard deviation of the parameters, and the next ones to try."""
        sizes = (arm.num_policy_obs, *self.units, arm.num_actions)
        num = sum((a + 1) * b for a, b in itertools.pairwise(sizes))
        return self.drawn(arm, jnp.zeros(num), jnp.ones(num), key)

    def collect(self, arm: Arm, states: Any, rngs: Any) -> Rollout:
        """Play one episode with every policy of every seed."""
        tried = jnp.concatenate([state["tried"] for state in states])
        weights, biases = arrays(jax.vmap(self.rebuild(arm))(tried))
        act = Stack(weights, biases, layer_norm=False)

        def actions(obs: np.ndarray, noise: np.ndarray) -> np.ndarray:
            rows = obs[..., arm.observer.policy_columns]
            return act(rows.reshape(-1, 1, rows.shape[-1])).reshape(noise.shape)

        return arm.rollout(actions, rngs)

    def update(self, arm: Arm, state: Any, rollout: Rollout, *, key: Any) -> tuple[Any, dict[str, float]]:
        """Move to the policies with the highest return, and draw the next around them."""
        first = np.cumsum(rollout.terminated, axis=0) - rollout.terminated == 0
        returns = np.sum((rollout.rewards + rollout.shaping) * first, axis=0)
        best = state["tried"][np.argsort(returns)[-max(2, int(self.elite * len(returns))) :]]
        new = self.drawn(arm, best.mean(axis=0), best.std(axis=0) + self.noise, key)
        return new, {"std": float(new["std"].mean())}

    def act(self, arm: Arm, state: Any) -> PolicyNetwork:
        """The policy in the middle."""
        return PolicyNetwork(*arrays(self.rebuild(arm)(state["mean"])))

    def drawn(self, arm: Arm, mean: Any, std: Any, key: Any) -> dict[str, Any]:
        """The state with these policies to try."""
        return {"mean": mean, "std": std, "tried": mean + std * jr.normal(key, (arm.num_envs, len(mean)))}

    def rebuild(self, arm: Arm) -> Any:
        """The function from parameters to a network of the right sizes."""
        sizes = (arm.num_policy_obs, *self.units, arm.num_actions)
        return ravel_pytree(MLP(sizes, key=jr.key(0)))[1]


def arrays(mlp: MLP) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights and biases of each layer."""
    return [np.asarray(w) for w in mlp.weights], [np.asarray(b) for b in mlp.biases]


ALGORITHM = CrossEntropy()
