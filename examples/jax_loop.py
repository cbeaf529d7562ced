"""A training loop in JAX: policy gradient on a batch of swing-ups, with a policy that observes z.

    python examples/jax_loop.py EMBEDDING --iterations 100

Only the policy uses JAX. The environments and the embedding use NumPy and MuJoCo.
"""

import argparse

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax

import planspace  # registers the tasks
from planspace.envs.wrappers import PlanSpaceVectorObservation

HORIZON, DISCOUNT = 200, 0.99


@eqx.filter_jit
def act(policy: eqx.nn.MLP, obs: jax.Array, key: jax.Array) -> jax.Array:
    """Sample actions from a unit Gaussian around the output of the network."""
    mean = jax.vmap(policy)(obs)
    return mean + jr.normal(key, mean.shape)


@eqx.filter_value_and_grad
def loss(policy: eqx.nn.MLP, obs: jax.Array, actions: jax.Array, advantages: jax.Array) -> jax.Array:
    """Minus the advantage-weighted log-probability of the actions [time, env]."""
    error = actions - jax.vmap(jax.vmap(policy))(obs)
    return jnp.mean(advantages * 0.5 * jnp.sum(error**2, axis=-1))


def main() -> None:
    """Train a policy and print the return of each iteration."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("embedding", metavar="EMBEDDING")
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--num-envs", type=int, default=100)
    arguments = parser.parse_args()
    planspace.register_tasks()
    task = "planspace/CartPoleSwingUp-v0"
    many = gymnasium.make_vec(
        task, num_envs=arguments.num_envs, vectorization_mode="vector_entry_point", obs="trig"
    )
    env = PlanSpaceVectorObservation(many, arguments.embedding)
    key, policy_key = jr.split(jr.key(0))
    policy = eqx.nn.MLP(env.single_observation_space.shape[0], 1, 32, 2, jax.nn.tanh, key=policy_key)
    optimiser = optax.adam(3e-3)
    state = optimiser.init(eqx.filter(policy, eqx.is_array))
    update = eqx.filter_jit(lambda p, s, *batch: step(optimiser, p, s, *batch))
    for iteration in range(arguments.iterations):
        obs, _ = env.reset(seed=iteration)
        seen, taken, earned = [], [], []
        for action_key in jr.split(jr.fold_in(key, iteration), HORIZON):
            actions = act(policy, obs, action_key)
            seen.append(obs)
            taken.append(actions)
            obs, rewards, _, _, _ = env.step(np.clip(actions, -3, 3))
            earned.append(rewards)
        policy, state = update(policy, state, np.stack(seen), jnp.stack(taken), advantages(np.stack(earned)))
        print(f"iteration {iteration}: return {np.sum(earned, axis=0).mean():.1f}")


def step(optimiser: optax.GradientTransformation, policy: eqx.nn.MLP, state, *batch):
    """Do one step of the optimiser."""
    _, gradient = loss(policy, *batch)
    updates, state = optimiser.update(gradient, state)
    return eqx.apply_updates(policy, updates), state


def advantages(rewards: np.ndarray) -> np.ndarray:
    """Discounted returns, centred over episodes at each step and scaled [time, env]."""
    returns = np.zeros_like(rewards)
    ahead = np.zeros(rewards.shape[1])
    for t in reversed(range(len(rewards))):
        ahead = returns[t] = rewards[t] + DISCOUNT * ahead
    return (returns - returns.mean(axis=1, keepdims=True)) / (returns.std() + 1e-8)


if __name__ == "__main__":
    main()
