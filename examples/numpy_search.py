"""Plain NumPy: cross-entropy search for a linear policy that sees z, on many swing-ups at once.

    python examples/numpy_search.py EMBEDDING --iterations 40

Every episode of the vector environment runs a policy of its own; the best tenth say where to look next.
"""

import argparse

import gymnasium
import numpy as np

import planspace  # registers the tasks
from planspace.envs.wrappers import PlanSpaceVectorObservation


def main() -> None:
    """Searches, and prints what the best policies earn."""
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
    mean, deviation = np.zeros(size), np.ones(size)
    for iteration in range(arguments.iterations):
        policies = mean + deviation * rng.standard_normal((arguments.num_envs, size))
        returns = np.zeros(arguments.num_envs)
        obs, _ = env.reset(seed=iteration)
        for _ in range(200):  # an episode of the swing-up, which never ends early
            actions = np.sum(policies * obs, axis=1, keepdims=True)
            obs, rewards, _, _, _ = env.step(np.clip(actions, -3, 3))
            returns += rewards
        best = policies[np.argsort(returns)[-arguments.num_envs // 10 :]]
        mean, deviation = best.mean(axis=0), best.std(axis=0) + 0.02
        print(f"iteration {iteration}: mean {returns.mean():7.1f}, best {returns.max():7.1f}")


if __name__ == "__main__":
    main()
