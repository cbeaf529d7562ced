"""Learning curves of ten seeds, compared with Stable-Baselines3 and sb3-contrib as an illustration.

    OPENBLAS_NUM_THREADS=1 python benchmarks/rl_beside_sb3.py

Swing-up with sin and cos, 200,000 steps per seed, with the settings the libraries share: 4000 steps per
iteration in 20 environments, 2 x 32 tanh, discount 0.99; TRPO with 10 conjugate gradient steps, max KL 0.01,
lambda 0.98; PPO with 10 epochs of minibatches of 500, Adam 1e-3, clip 0.2, lambda 0.95. The critics differ:
the libraries train theirs by gradient steps along with the policy, planspace fits its critic again in each
iteration. The seeds of the libraries are stored in results/rl/sb3.csv; algorithms that it contains are not
run again. Draws results/rl/beside-sb3.png and prints the table.
"""

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from planspace.figures.learning_curves import plot_curves
from planspace.figures.style import save_figure
from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms import PRESETS
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.rl.learning_curve import learning_curve
from planspace.rl.training import train_policies
from planspace.seams import with_settings
from planspace.storage.files import make_folder
from planspace.study.tidy import Row, read_rows, write_rows
from planspace.tasks.catalog import TASKS

RESULTS = Path(__file__).parent.parent / "results" / "rl"
FILE = RESULTS / "sb3.csv"
TASK, OBS = TASKS["cartpole-swingup"], "trig"
NUM_SEEDS, STEPS = 10, 200_000
SHARED: dict[str, Algorithm] = {
    "trpo": with_settings(PRESETS["trpo", "paper"], critic="mlp", bootstrap_timeout=True),
    "ppo": with_settings(PRESETS["ppo", "modern"], normalise_obs=False),
}


def library(algo: str, seed: int) -> list[Row]:
    """Train one seed with a library and return the mean return of each iteration's episodes."""
    import gymnasium
    import torch
    from sb3_contrib import TRPO
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

    class Returns(BaseCallback):
        """Collects the mean return of each iteration's episodes."""

        def __init__(self) -> None:
            super().__init__()
            self.means: list[float] = []

        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            last = list(self.model.ep_info_buffer)[-BATCH_STEPS // TASK.horizon :]
            self.means.append(float(np.mean([episode["r"] for episode in last])))

    torch.set_num_threads(1)
    num_envs = BATCH_STEPS // TASK.horizon
    env = VecMonitor(DummyVecEnv([lambda: gymnasium.make(TASK.env_id, obs=OBS)] * num_envs))
    shared = {"n_steps": TASK.horizon, "seed": seed, "device": "cpu", "policy_kwargs": {"net_arch": [32, 32]}}
    if algo == "trpo":
        agent = TRPO("MlpPolicy", env, cg_max_steps=10, gae_lambda=0.98, target_kl=0.01, **shared)
    else:
        agent = PPO("MlpPolicy", env, n_epochs=10, batch_size=500, learning_rate=1e-3, **shared)
    returns = Returns()
    agent.learn(STEPS, callback=returns)
    return [
        Row("sb3", algo, seed, None, BATCH_STEPS * (i + 1), "return", round(value, 2))
        for i, value in enumerate(returns.means)
    ]


def main() -> None:
    rows = read_rows(FILE) if FILE.exists() else []
    missing = [algo for algo in SHARED if all(row.arm != algo for row in rows)]
    with ProcessPoolExecutor(2, get_context("spawn")) as workers:
        for algo in missing:
            for more in workers.map(partial(library, algo), range(NUM_SEEDS)):
                rows += more
            write_rows(rows, make_folder(RESULTS) / FILE.name)
    curves = {}
    for algo in SHARED:
        theirs = [[r.value for r in rows if (r.arm, r.seed) == (algo, i)] for i in range(NUM_SEEDS)]
        name = "sb3-contrib" if algo == "trpo" else "Stable-Baselines3"
        config = TrainConfig(SHARED[algo], OBS, num_seeds=NUM_SEEDS, steps=STEPS)
        ours = train_policies(TASK, config).history["return"]
        for label, returns in ((f"{algo.upper()}, planspace", ours), (f"{algo.upper()}, {name}", theirs)):
            table = np.array(returns) if returns is ours else np.array(returns).T
            steps = BATCH_STEPS * np.arange(1, len(table) + 1)
            curves[label] = learning_curve({"return": table, "steps": steps})
            last = table[-10:].mean(axis=0)
            error = last.std(ddof=1) / np.sqrt(NUM_SEEDS)
            print(f"{label:<26}{last.mean():>8.1f} +- {error:.1f}   ({last.min():.1f}, {last.max():.1f})")
    print(save_figure(plot_curves(curves, "swing-up, ten seeds each"), RESULTS, "beside-sb3"))
    print("command: python benchmarks/rl_beside_sb3.py; returns of the last ten iterations (worst, best)")


if __name__ == "__main__":
    main()
