"""An agent in NumPy: cross-entropy search for a linear policy that observes z, on a batch of swing-ups.

    python examples/numpy_search.py EMBEDDING --iterations 40

Each episode of the vector environment runs a different policy. The best tenth of the policies set the mean
and the standard deviation of the next iteration.
"""

import argparse

import gymnasium
import numpy as np

import planspace  # registers the tasks
from planspace.envs.wrappers import PlanSpaceVectorObservation


def main() -> None:
    """Search, and print the mean and the best return of each iteration."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("embedding", metavar="EMBEDDING")
    parser.add_argument("--iterations", type=int, default=40)
    parser.add_argument("--num-envs", type=int, default=300)
    arguments = parser.parse_args()
    planspace.register_tasks()
    task = "planspace/CartPoleSwingUp-v0"
    many = gymnasium.make_vec(
        task, num_envs=arguments.num_envs, vectorization_mode="vector_entry_point", obs="trig"
    )
    env = PlanSpaceVectorObservation(many, arguments.embedding)
    rng = np.random.default_rng(0)
    size = env.single_observation_space.shape[0]
    mean, std = np.zeros(size), np.ones(size)
    for iteration in range(arguments.iterations):
        policies = mean + std * rng.standard_normal((arguments.num_envs, size))
        returns = np.zeros(arguments.num_envs)
        obs, _ = env.reset(seed=iteration)
        for _ in range(200):  # one episode of the swing-up, which never terminates early
            actions = np.sum(policies * obs, axis=1, keepdims=True)
            obs, rewards, _, _, _ = env.step(np.clip(actions, -3, 3))
            returns += rewards
        best = policies[np.argsort(returns)[-arguments.num_envs // 10 :]]
        mean, std = best.mean(axis=0), best.std(axis=0) + 0.02
        print(f"iteration {iteration}: mean {returns.mean():7.1f}, best {returns.max():7.1f}")


if __name__ == "__main__":
    main()
