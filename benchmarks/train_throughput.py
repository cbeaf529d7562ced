"""Training speed of all seeds in one program, compared with bare physics and with a library.

    python benchmarks/train_throughput.py [--repeats N] [--seeds N] [--growth] [--memory]

For each algorithm and preset, one run measures in turn: training of all seeds, updates included; bare
`mujoco.batch` physics of the same environments with the controls of training; and two processes of
sb3-contrib's TRPO or Stable-Baselines3's PPO, one seed each, with the settings that the libraries share. The
libraries run once with one environment, as in their documentation, and once with the 20 episodes of an
iteration in parallel, which needs fewer calls of the policy. Each ratio compares measurements of the same
turn. A first run with the same shapes excludes compilation.

--growth   1 to 60 seeds, TRPO (paper) and PPO (modern), with the fractions of time spent on each part
--memory   the peak memory of training 60 seeds for five iterations
"""

import argparse
import multiprocessing
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from planspace.envs.batch import TaskBatch
from planspace.physics.simulator import Simulator
from planspace.rl import agent, training
from planspace.rl import arm as arm_module
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.tasks.catalog import TASKS
from planspace.workers import count_cores

TASK = TASKS["cartpole-swingup"]
ITERATIONS = 25
"""The iterations between two evaluations, so that the time of one evaluation is included."""
ARMS: list[tuple[str, str]] = [("trpo", "paper"), ("ppo", "paper"), ("ppo", "modern")]
SEEDS = (1, 5, 15, 30, 60)
LIBRARY_STEPS = 20_000
LIBRARY_ENVS = (1, 20)


def timed(function: Callable, spent: Counter, name: str) -> Callable:
    lock = threading.Lock()

    def wrapper(*args: Any, **kwargs: Any) -> Any:
        began = time.perf_counter()
        try:
            return function(*args, **kwargs)
        finally:
            with lock:
                spent[name] += time.perf_counter() - began

    return wrapper


def timed_training(config: TrainConfig) -> tuple[float, Counter]:
    """Steps per second of all seeds together, and the seconds spent in each part."""
    spent: Counter = Counter()
    parts = [(arm_module, "collect"), (training, "collect"), (agent, "update")]
    patches = [mock.patch.object(o, name, timed(getattr(o, name), spent, name)) for o, name in parts]
    patches.append(mock.patch.object(Simulator, "step", timed(Simulator.step, spent, "physics")))
    for patch in patches:
        patch.start()
    began = time.perf_counter()
    training.train_policies(TASK, config)
    wall = time.perf_counter() - began
    for patch in patches:
        patch.stop()
    spent["wall"] = wall
    return config.num_seeds * config.steps / wall, spent


class Replay:
    """The controls of a training iteration, to measure the physics without anything else."""

    def __init__(self, config: TrainConfig):
        taken: list[Any] = []
        collect = arm_module.collect

        def keep(*args: Any, **kwargs: Any) -> Any:
            taken.append(collect(*args, **kwargs))
            return taken[-1]

        with mock.patch.object(arm_module, "collect", keep):
            training.train_policies(TASK, replace(config, steps=10 * BATCH_STEPS))
        num = config.num_seeds * BATCH_STEPS // TASK.horizon
        last = taken[-1]
        self.starts = last.obs[0, ..., : len(TASK.start_low)].reshape(num, -1).astype(float)
        self.controls = last.actions.reshape(TASK.horizon, num, -1).astype(float)
        self.batch = TaskBatch(TASK, num)

    def rate(self) -> float:
        """Steps per second of all environments together."""
        began = time.perf_counter()
        for _ in range(ITERATIONS):
            self.batch.reset(self.starts, self.batch.targets)
            for control in self.controls:
                self.batch.simulator.step(control, TASK.frame_skip)
        return ITERATIONS * self.controls.shape[0] * self.controls.shape[1] / (time.perf_counter() - began)


def library_process(num_envs: int, algo: str, preset: str, seed: int, start: Any, results: Any) -> None:
    import gymnasium
    import torch
    from sb3_contrib import TRPO
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv

    torch.set_num_threads(1)
    env = DummyVecEnv([lambda: gymnasium.make(TASK.env_id, obs="raw")] * num_envs)
    shared = {
        "n_steps": BATCH_STEPS // num_envs,
        "seed": seed,
        "device": "cpu",
        "policy_kwargs": {"net_arch": [32, 32]},
    }
    if algo == "trpo":
        agent = TRPO("MlpPolicy", env, batch_size=125, cg_max_steps=10, gae_lambda=0.98, **shared)
    else:
        minibatch = (
            500 if preset == "modern" else BATCH_STEPS
        )  # `paper`: 32 trajectories, more than a batch has
        agent = PPO("MlpPolicy", env, n_epochs=10, batch_size=minibatch, learning_rate=1e-3, **shared)
    agent.learn(BATCH_STEPS)
    start.wait()
    began = time.perf_counter()
    agent.learn(LIBRARY_STEPS)
    results.put(LIBRARY_STEPS / (time.perf_counter() - began))


def library(num_envs: int, algo: str, preset: str) -> float:
    context = multiprocessing.get_context("spawn")
    results, start = context.Queue(), context.Barrier(2)
    workers = [
        context.Process(target=library_process, args=(num_envs, algo, preset, i, start, results))
        for i in range(2)
    ]
    for worker in workers:
        worker.start()
    rates = [results.get() for _ in workers]
    for worker in workers:
        worker.join()
    return sum(rates)


def compare(num_seeds: int, repeats: int) -> None:
    print(f"{num_seeds} seeds: least, median and most of {repeats} turns")
    head = ("training [steps/s]", "to bare physics", *(f"to a library, {n} env(s)" for n in LIBRARY_ENVS))
    print(f"{'':<16}" + "".join(f"{text:>32}" for text in head))
    for algo, preset in ARMS:
        config = arm(algo, preset, num_seeds)
        replay = Replay(config)
        timed_training(config)
        turns = []
        for i in range(repeats):
            rate = timed_training(replace(config, seed=100 * i))[0]
            libraries = [rate / library(n, algo, preset) for n in LIBRARY_ENVS]
            turns.append((rate, rate / replay.rate(), *libraries))
        columns = zip(*turns, strict=True)
        cells = []
        for values, form in zip(columns, (",.0f", ".2f", ".1f", ".1f"), strict=True):
            cells.append(" ".join(f"{f(values):>9{form}}" for f in (np.min, np.median, np.max)))
        print(f"{algo + ', ' + preset:<16}" + "".join(f"{cell:>32}" for cell in cells), flush=True)


def growth() -> None:
    """Print the fraction of time spent on each part.

    The parts are physics; the rest of acting; the updates of the seeds, as their summed time divided by the
    number of cores; and everything else: waiting for the last update, copies and files.
    """
    print(f"{'':<16}{'seeds':>6}{'steps/s':>12}{'physics':>10}{'policy':>10}{'update':>10}{'the rest':>10}")
    for algo, preset in (ARMS[0], ARMS[-1]):
        for num_seeds in SEEDS:
            config = arm(algo, preset, num_seeds)
            timed_training(replace(config, steps=BATCH_STEPS))
            rate, spent = timed_training(config)
            wall, acting = spent["wall"], spent["collect"]
            learning = wall - acting
            busy = min(spent["update"] / min(count_cores(), num_seeds), learning)
            fractions = spent["physics"] / wall, (acting - spent["physics"]) / wall, busy / wall
            row = "".join(f"{x:>10.0%}" for x in (*fractions, 1 - sum(fractions)))
            print(f"{algo + ', ' + preset:<16}{num_seeds:>6}{rate:>12,.0f}{row}", flush=True)


def memory() -> None:
    for algo, preset in ARMS:
        code = (
            "import benchmarks.train_throughput as b, resource; "
            f"b.timed_training(b.replace(b.arm({algo!r}, {preset!r}, 60), steps=5 * b.BATCH_STEPS)); "
            "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
        )
        root = Path(__file__).parent.parent
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root
        )
        print(f"{algo}, {preset}: 60 seeds, most memory {float(done.stdout):,.0f} MiB", flush=True)


def arm(algo: str, preset: str, num_seeds: int) -> TrainConfig:
    return TrainConfig(find_algorithm(algo, preset), num_seeds=num_seeds, steps=ITERATIONS * BATCH_STEPS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=15)
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--memory", action="store_true")
    options = parser.parse_args()
    print("command: python benchmarks/train_throughput.py", *sys.argv[1:])
    if options.growth:
        growth()
    elif options.memory:
        memory()
    else:
        compare(options.seeds, options.repeats)


if __name__ == "__main__":
    main()
