"""Speed of SAC, as a ratio to Stable-Baselines3's SAC of equal sizes (extra `sb3`), on one core.

    python benchmarks/sac_speed.py
    python benchmarks/sac_speed.py --steps 2000 --repetitions 5

Both train one seed on the swing-up with the defaults of Stable-Baselines3: networks of 2 x 256 units,
batches of 256, and one gradient step per environment step. The two take turns. Prints environment steps per
CPU second of the whole training, gradient steps per CPU second of the updates alone, and the ratios: the
median, minimum and maximum of the repetitions. CPU seconds leave out the time of other work on the core.
Compiling is not counted.
"""

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest import mock

TASK, ENV_ID = "cartpole-swingup", "planspace/CartPoleSwingUp-v0"


def seconds(run: Callable[[], Any], kind: type, method: str) -> tuple[float, float]:
    """CPU seconds that a training takes, and those within a method that makes the updates."""
    own, spent = getattr(kind, method), []

    def timed(*args: Any, **options: Any) -> Any:
        start = time.process_time()
        result = own(*args, **options)
        spent.append(time.process_time() - start)
        return result

    with mock.patch.object(kind, method, timed):
        start = time.process_time()
        run()
        return time.process_time() - start, sum(spent)


def main() -> None:
    """Measure both, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=1000, help="environment steps of a repetition")
    parser.add_argument("--repetitions", type=int, default=3)
    arguments = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # before the libraries start their threads

    import gymnasium
    import numpy as np
    import stable_baselines3
    import torch

    from planspace.rl.algorithms.sac import SAC
    from planspace.rl.config import TrainConfig
    from planspace.rl.training import train_policies

    torch.set_num_threads(1)
    settings = SAC(replay_size=arguments.steps, learning_starts=0)  # the same shapes in each run
    config = TrainConfig(settings, num_seeds=1, steps=arguments.steps, batch_steps=1000, eval_every=0)
    train_policies(TASK, config, verbose=False)  # compiles
    rows = []
    for i in range(arguments.repetitions):
        ours = seconds(
            lambda seed=i: train_policies(TASK, replace(config, seed=seed), verbose=False), SAC, "update"
        )
        kind = stable_baselines3.SAC
        agent = kind("MlpPolicy", gymnasium.make(ENV_ID), learning_starts=0, buffer_size=1000, device="cpu")
        theirs = seconds(lambda agent=agent: agent.learn(arguments.steps), kind, "train")
        rows.append((*ours, *theirs))
    ours, theirs = np.split(arguments.steps / np.array(rows), 2, axis=1)
    columns = zip(("environment steps", "gradient steps"), ours.T, theirs.T, (ours / theirs).T, strict=True)
    print(f"{'per CPU second':<20}{'planspace':>10}{'SB3':>10}   ratio (minimum, maximum)")
    for name, own, other, ratio in columns:
        spread = f"{np.median(ratio):.1f} ({ratio.min():.1f}, {ratio.max():.1f})"
        print(f"{name:<20}{np.median(own):>10.0f}{np.median(other):>10.0f}   {spread}")


if __name__ == "__main__":
    main()
