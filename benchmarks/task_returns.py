"""Returns of untrained policies in every task, as a reference for other returns.

    python benchmarks/task_returns.py [--episodes 1000]

Idle applies no control, noise a unit Gaussian (clipped to the controls' range), random a uniform control in
that range. An episode lasts for the task's horizon, or until the task terminates it.
"""

import argparse

import numpy as np

from planspace.envs.batch import TaskBatch
from planspace.tasks.catalog import TASKS
from planspace.tasks.observation_types import RewardType
from planspace.tasks.task import Task

POLICIES = ("idle", "noise", "random")


def returns(task: Task, policy: str, num: int, reward: RewardType = "dense") -> np.ndarray:
    """The return of each of `num` episodes."""
    rng = np.random.default_rng(0)
    batch = TaskBatch(task, num, reward=reward)
    batch.reset(*task.sample_starts(num, rng))
    low, high = batch.simulator.model.actuator_ctrlrange.T
    total, alive = np.zeros(num), np.ones(num, dtype=bool)
    for _ in range(task.horizon):
        actions = np.zeros((num, len(low)))
        if policy == "noise":
            actions = rng.standard_normal(actions.shape)
        elif policy == "random":
            actions = rng.uniform(low, high, actions.shape)
        rewards, terminated, diverged = batch.step(actions)
        total += np.where(alive, rewards, 0.0)
        alive &= ~(terminated | diverged)
    return total


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=1000)
    arguments = parser.parse_args()
    print(f"command: python benchmarks/task_returns.py --episodes {arguments.episodes}")
    print("| task | " + " | ".join(POLICIES) + " |\n|" + "---|" * (len(POLICIES) + 1))
    for task in TASKS.values():
        for form in task.reward_types:
            if form == "sparse":
                continue
            cells = []
            for policy in POLICIES:
                total = returns(task, policy, arguments.episodes, form)
                cells.append(f"{total.mean():.1f} ({total.std():.1f})")
            name = task.env_id if form == "dense" else f"{task.env_id}, reward='2020'"
            print(f"| `{name}` | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
