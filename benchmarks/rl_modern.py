"""What the `modern` presets were chosen from: variants of one setting or two, six seeds (100 to 105) each.

    OPENBLAS_NUM_THREADS=1 python benchmarks/rl_modern.py [--out DIR]

The seeds are others than those that any result is reported on. Each variant is kept in
results/rl/modern/TASK-VARIANT.json as it is done, and not run again. An hour on two cores.
"""

import argparse
import json
from pathlib import Path

from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms.on_policy import OnPolicy
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.config import TrainConfig, with_settings
from planspace.rl.training import train_policies
from planspace.storage.files import write_bytes
from planspace.storage.json_files import read_json

RESULTS = Path(__file__).parent.parent / "results" / "rl" / "modern"
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
    RESULTS.mkdir(parents=True, exist_ok=True)
    print("command: python benchmarks/rl_modern.py; mean of the last 10 iterations (worst, best); of all")
    for task, (obs, steps) in TASKS.items():
        for name, algorithm in VARIANTS.items():
            path = RESULTS / f"{task}-{name}.json"
            if not path.exists():
                seeds = {"num_seeds": NUM_SEEDS, "seed": FIRST_SEED}
                config = TrainConfig(algorithm, obs, steps=steps, **seeds)
                returns = train_policies(task, config, out=options.out / path.stem).history["return"]
                last = returns[-10:].mean(axis=0)
                row = {"mean": last.mean(), "worst": last.min(), "best": last.max(), "area": returns.mean()}
                rounded = {key: round(float(value), 1) for key, value in row.items()}
                write_bytes(path, (json.dumps(rounded) + "\n").encode())
            row = read_json(path)
            numbers = f"{row['mean']:>8} ({row['worst']}, {row['best']})"
            print(f"{task:<18}{name:<24}{numbers:<28}{row['area']:>8}", flush=True)


if __name__ == "__main__":
    main()
