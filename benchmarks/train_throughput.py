"""TRPO over five seeds, learning included, against bare `mujoco.batch` stepping of the same 100 environments.

    python benchmarks/train_throughput.py [REPEATS]

Both are timed in turn in one process; the ratio is taken pair by pair. Compilation is left out by one
training run of the same shapes before the clock starts.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from planspace.envs.batch import TaskBatch
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.rl.train import train
from planspace.tasks import TASKS

NUM_SEEDS, ITERATIONS = 5, 20
TASK = TASKS["cartpole-swingup"]


def training_rate(seed: int) -> float:
    config = TrainConfig(TASK.name, num_seeds=NUM_SEEDS, seed=seed, steps=ITERATIONS * BATCH_STEPS)
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        train(config, Path(folder) / "run")
        return NUM_SEEDS * config.steps / (time.perf_counter() - began)


def physics_rate(seed: int) -> float:
    """Bare stepping: random controls, no observation, reward or learning."""
    num = NUM_SEEDS * BATCH_STEPS // TASK.horizon
    rng = np.random.default_rng(seed)
    batch = TaskBatch(TASK, num)
    batch.reset(*TASK.sample_starts(num, rng))
    controls = rng.uniform(-3, 3, (TASK.horizon, num, 1))
    simulator = batch.simulator
    began = time.perf_counter()
    for _ in range(ITERATIONS):
        for control in controls:
            simulator.step(control, TASK.frame_skip)
    return NUM_SEEDS * ITERATIONS * BATCH_STEPS / (time.perf_counter() - began)


def main() -> None:
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    training_rate(0)
    pairs = np.array([(training_rate(i), physics_rate(i)) for i in range(1, repeats + 1)])
    ratios = pairs[:, 0] / pairs[:, 1]
    print("command: python benchmarks/train_throughput.py", repeats)
    print(f"{'':<26}{'least':>10}{'median':>10}{'most':>10}")
    rows = {"TRPO [steps/s]": pairs[:, 0], "bare physics [steps/s]": pairs[:, 1], "ratio": ratios}
    for name, values in rows.items():
        form = ".2f" if name == "ratio" else ",.0f"
        spread = [format(f(values), form) for f in (np.min, np.median, np.max)]
        print(f"{name:<26}" + "".join(f"{s:>10}" for s in spread))


if __name__ == "__main__":
    main()
