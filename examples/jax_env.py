"""z inside a JAX environment: a wrapper for environments in the style of Brax and MuJoCo Playground.

    python examples/jax_env.py EMBEDDING --iterations 100

EMBEDDING is an embedding of cart-pole states, written by `planspace embed` or `planspace run`. Environments
of this style are pure functions, `reset(rng) -> state` and `step(state, action) -> state`, with the
observation in `state.obs`. `PlanSpaceWrapper` appends z to it. Brax is not needed: the environment is a small
cart-pole. A policy learns from the gradient of the distance in z to the goal, through encoder and physics.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import optax

import planspace as ps

NUM_STEPS = 25


@partial(jax.tree_util.register_dataclass, data_fields=["obs", "reward", "done"], meta_fields=[])
@dataclass(frozen=True)
class State:
    """The state of an episode, with the fields of a Brax state that are used here."""

    obs: jax.Array
    reward: jax.Array
    done: jax.Array

    def replace(self, **fields) -> "State":
        """Return a copy with other values, as in Brax."""
        return replace(self, **fields)


class CartPole:
    """A cart of 9.4 kg and a pole of 4.9 kg, 0.6 m long. It observes x, theta (0 is up) and velocities."""

    def reset(self, rng: jax.Array) -> State:
        """Start an episode at rest, with the pole anywhere."""
        x, theta = jr.uniform(rng, (2,), minval=-1.0) * jnp.array([0.1, jnp.pi])
        return State(jnp.array([x, theta, 0.0, 0.0]), jnp.zeros(()), jnp.zeros(()))

    def step(self, state: State, action: jax.Array) -> State:
        """Apply a force of up to 300 N to the cart for 0.04 s."""
        x, theta, xd, thetad = state.obs[:4]
        force = 100 * jnp.clip(action[0], -3, 3) - xd
        sin, cos, cart, pole, half = jnp.sin(theta), jnp.cos(theta), 9.4, 4.9, 0.3
        push = (force + pole * half * thetad**2 * sin) / (cart + pole)
        thetadd = (9.81 * sin - cos * push) / (half * (4 / 3 - pole * cos**2 / (cart + pole)))
        xd = xd + 0.04 * (push - pole * half * thetadd * cos / (cart + pole))
        thetad = thetad + 0.04 * thetadd
        obs = jnp.array([x + 0.04 * xd, theta + 0.04 * thetad, xd, thetad])
        return state.replace(obs=obs, reward=cos)


class PlanSpaceWrapper:
    """An environment that observes z after the numbers of the environment `env`.

    The state is the first `num` numbers of the observation. In Brax, take `qpos` and `qvel` of
    `state.pipeline_state` instead if the observation holds something else.
    """

    def __init__(self, env: CartPole, encode: Callable[[jax.Array], jax.Array], num: int):
        self.env, self.encode, self.num = env, encode, num

    def reset(self, rng: jax.Array) -> State:
        """Start an episode."""
        return self._observe(self.env.reset(rng))

    def step(self, state: State, action: jax.Array) -> State:
        """Do one step."""
        return self._observe(self.env.step(state, action))

    def _observe(self, state: State) -> State:
        return state.replace(obs=jnp.concatenate((state.obs, self.encode(state.obs[: self.num]))))


def main() -> None:
    """Train a policy and print the distance in z of each iteration."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("embedding", metavar="EMBEDDING")
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--num-envs", type=int, default=256)
    arguments = parser.parse_args()
    embedding = ps.load_embedding(arguments.embedding)
    encode = ps.jax_function(embedding)
    env = PlanSpaceWrapper(CartPole(), encode, embedding.state_dim)
    goal = encode(jnp.zeros(embedding.state_dim))

    def distance(policy: eqx.nn.MLP, rng: jax.Array) -> jax.Array:
        """Mean distance in z to the goal over one episode."""

        def step(state: State, _: None) -> tuple[State, jax.Array]:
            state = env.step(state, policy(state.obs))
            return state, jnp.linalg.norm(state.obs[embedding.state_dim :] - goal)

        return jax.lax.scan(step, env.reset(rng), length=NUM_STEPS)[1].mean()

    @eqx.filter_value_and_grad
    def loss(policy: eqx.nn.MLP, rngs: jax.Array) -> jax.Array:
        return jax.vmap(partial(distance, policy))(rngs).mean()

    @eqx.filter_jit
    def update(policy: eqx.nn.MLP, state: optax.OptState, rng: jax.Array):
        value, gradient = loss(policy, jr.split(rng, arguments.num_envs))
        updates, state = optimiser.update(gradient, state)
        return eqx.apply_updates(policy, updates), state, value

    num_obs = embedding.state_dim + embedding.z_dim
    policy = eqx.nn.MLP(num_obs, 1, 32, 2, jax.nn.tanh, key=jr.key(0))
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(3e-3))
    state = optimiser.init(eqx.filter(policy, eqx.is_array))
    for iteration in range(arguments.iterations):
        policy, state, value = update(policy, state, jr.key(iteration + 1))
        print(f"iteration {iteration}: mean distance in z {value:.3f}")


if __name__ == "__main__":
    main()
