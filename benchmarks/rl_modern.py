"""Candidates for the `modern` presets: variants of one or two settings, six seeds (100 to 105) each.

    OPENBLAS_NUM_THREADS=1 python benchmarks/rl_modern.py [--out DIR]

No other result uses these seeds. Each variant is stored in results/rl/modern.csv as soon as it is done, and
is not run again. This takes an hour on two cores.
"""

import argparse
from pathlib import Path

from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms.on_policy import OnPolicy
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.config import TrainConfig
from planspace.rl.training import train_policies
from planspace.seams import with_settings
from planspace.storage.files import make_folder
from planspace.study.tidy import Row, read_rows, write_rows

FILE = Path(__file__).parent.parent / "results" / "rl" / "modern.csv"
FIRST_SEED, NUM_SEEDS = 100, 6
TASKS = {
    "cartpole-swingup": ("trig", 960_000),
    "cartpole": ("raw", 200_000),
    "reacher-trig": ("raw", 400_000),
}
BASE = TRPO(OnPolicy(critic="mlp", normalise_obs=True, bootstrap_timeout=True))
STEPS = PPO(
    OnPolicy(gae_lambda=0.95, critic="mlp", normalise_obs=True, bootstrap_timeout=True),
    minibatch=500,
    of_steps=True,
    tolerance=0.0,
    clip_norm=0.5,
)
FINER = with_settings(STEPS, minibatch=125, learning_rate=5e-4)
VARIANTS: dict[str, Algorithm] = {
    "ppo-base": STEPS,
    "ppo-lr5e-4": with_settings(STEPS, learning_rate=5e-4),
    "ppo-mb250": with_settings(STEPS, minibatch=250),
    "ppo-mb125-lr5e-4": FINER,
    "ppo-mb125-lr5e-4-lam98": with_settings(FINER, gae_lambda=0.98),
    "ppo-nonorm": with_settings(STEPS, normalise_obs=False),
    "ppo-noboot": with_settings(STEPS, bootstrap_timeout=False),
    "ppo-lam98": with_settings(STEPS, gae_lambda=0.98),
    "trpo-base": BASE,
    "trpo-linear-noboot": with_settings(BASE, critic="linear", bootstrap_timeout=False),
    "trpo-kl02": with_settings(BASE, max_kl=0.02),
    "trpo-kl02-lam95": with_settings(BASE, gae_lambda=0.95, max_kl=0.02),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/rl-modern"), help="folder of the runs")
    options = parser.parse_args()
    rows = read_rows(FILE) if FILE.exists() else []
    print("command: python benchmarks/rl_modern.py; mean of the last 10 iterations (worst, best); of all")
    for task, (obs, steps) in TASKS.items():
        for name, algorithm in VARIANTS.items():
            arm = f"{task}, {name}"
            if all(row.arm != arm for row in rows):
                seeds = {"num_seeds": NUM_SEEDS, "seed": FIRST_SEED}
                config = TrainConfig(algorithm, obs, steps=steps, **seeds)
                returns = train_policies(task, config, out=options.out / f"{task}-{name}").history["return"]
                last = returns[-10:].mean(axis=0)
                of = (last.mean(), last.min(), last.max(), returns.mean())
                rows += [
                    Row("modern", arm, None, None, None, f"{metric}_return", round(float(value), 1))
                    for metric, value in zip(("mean", "worst", "best", "whole"), of, strict=True)
                ]
                write_rows(rows, make_folder(FILE.parent) / FILE.name)
            mean, worst, best, whole = (row.value for row in rows if row.arm == arm)
            numbers = f"{mean:>8} ({worst}, {best})"
            print(f"{task:<18}{name:<24}{numbers:<28}{whole:>8}", flush=True)


if __name__ == "__main__":
    main()
