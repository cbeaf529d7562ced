"""Training speed on Gymnasium environments, compared with planspace's own tasks.

    python benchmarks/gymnasium_throughput.py [TASK ...] [--env-workers N]

For each task, one run of TRPO with five seeds measures environment steps per second of all seeds together:
while episodes are collected, and with updates. Each is the median of the iterations after the first, which
compiles.
"""

import argparse
import time
from typing import Any
from unittest import mock

import numpy as np

from planspace.rl import arm, training
from planspace.rl.config import BATCH_STEPS, TrainConfig

TASKS = ("gym:Hopper-v5", "gym:InvertedPendulum-v5", "acrobot-swingup", "cartpole-swingup")
ITERATIONS = 6


def rates(task: str, workers: int) -> tuple[float, float]:
    """Steps per second while collecting, and of whole iterations."""
    collect, iterate = arm.collect, training._iterate
    collected, iterated, sizes = [], [], []

    def timed_collect(*args: Any, **options: Any) -> Any:
        began = time.perf_counter()
        rollout = collect(*args, **options)
        collected.append(time.perf_counter() - began)
        sizes.append(rollout.rewards.size)
        return rollout

    def timed_iterate(*args: Any) -> Any:
        began = time.perf_counter()
        state = iterate(*args)
        iterated.append(time.perf_counter() - began)
        return state

    config = TrainConfig(steps=ITERATIONS * BATCH_STEPS, eval_every=0)
    with (
        mock.patch.object(arm, "collect", timed_collect),
        mock.patch.object(training, "_iterate", timed_iterate),
    ):
        training.train_policies(task, config, env_workers=workers, verbose=False)
    return sizes[0] / float(np.median(collected[1:])), sizes[0] / float(np.median(iterated[1:]))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("tasks", nargs="*", default=TASKS, metavar="TASK")
    parser.add_argument("--env-workers", type=int, default=0, metavar="N", help="for Gymnasium environments")
    args = parser.parse_args()
    for task in args.tasks:
        collecting, whole = rates(task, args.env_workers if task.startswith("gym:") else 0)
        print(f"{task:30}{collecting:9,.0f} steps/s collecting{whole:9,.0f} steps/s training", flush=True)


if __name__ == "__main__":
    main()
