"""Cost of SAC on one core: steps per CPU second for one seed and for several in one program.

    OPENBLAS_NUM_THREADS=1 python benchmarks/sac_cost.py
    python benchmarks/sac_cost.py dmc:acrobot-swingup --action-repeat 2 --seeds 1 5 10

Trains the preset `modern` with each size of networks and each number of seeds, and divides the gradient
steps of all seeds by the CPU time of the process, so that other work on the machine matters little. Compiling
is not counted. Prints gradient steps per CPU second, and the hours of a core that a million of them take.
"""

import argparse
import os
import time
from dataclasses import replace

TASK = "acrobot-swingup"
SIZES = ((64, 64), (256, 256))


def main() -> None:
    """Measure each size and number of seeds, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("task", nargs="?", default=TASK)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 5])
    parser.add_argument("--steps", type=int, default=3000, help="environment steps of a seed")
    parser.add_argument("--action-repeat", type=int, default=1)
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # before the libraries start their threads

    from planspace.rl.algorithms import find_algorithm
    from planspace.rl.config import TrainConfig
    from planspace.rl.training import train_policies
    from planspace.seams import with_settings

    print("| networks | seeds | gradient steps per CPU second | core hours per million |\n|---|---|---|---|")
    for hidden in SIZES:
        algorithm = with_settings(
            find_algorithm("sac", "modern"), hidden=hidden, critic_hidden=hidden, learning_starts=0
        )
        for num in options.seeds:
            repeat = options.action_repeat
            config = TrainConfig(
                algorithm, num_seeds=num, steps=options.steps, eval_every=0, action_repeat=repeat
            )
            train_policies(options.task, config, verbose=False)  # compiles
            start = time.process_time()
            trained = train_policies(options.task, replace(config, seed=100), verbose=False)
            seconds = time.process_time() - start
            rate = num * int(trained.history["steps"][-1]) / repeat / seconds
            size = " x ".join(map(str, hidden))
            print(f"| {size} | {num} | {rate:.0f} | {1e6 / rate / 3600:.1f} |", flush=True)


if __name__ == "__main__":
    main()
