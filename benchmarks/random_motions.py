r"""Fast motions between random states, as demonstrations.

    python benchmarks/random_motions.py cartpole-swingup --num 1200 --out motions
    planspace embed motions --time-head --time-hidden 256 256 --time-steps 12000 \
        --time-plan-weight 1000 --out z

Motions at full control begin at uniform states of the start box and are polished to the shortest duration
between their ends, as in `true_times.py --from-box`, with other random numbers. An embedding that is trained
on them knows times between more states than one that is trained on plans to one goal.

The same command goes on, and a larger `--num` adds motions, 100 at a time.
"""

import argparse
from pathlib import Path

import numpy as np
from true_times import Plant, polished_motion

from planspace.demos.episode import Episode
from planspace.demos.folder import DemoFolder
from planspace.plan.demonstrations import state_info
from planspace.plan.trajectory import Trajectory
from planspace.tasks.problem_file import load_problem

PART = 100
"""Motions of a part."""


def polished_motions(plant: Plant, num: int, rng: np.random.Generator) -> list[Trajectory]:
    """Draw motions until enough of them could be polished."""
    found: list[Trajectory] = []
    while len(found) < num:
        (start,) = plant.box_states(1, rng)
        if (motion := polished_motion(plant, start, rng)) is not None:
            found.append(motion[0])
    return found


def episode_of(motion: Trajectory, step: float, index: int) -> Episode:
    """A motion as a demonstration."""
    states, controls = motion.states, motion.controls
    times = step * np.arange(len(states))
    return Episode(states, controls, times, states[-1], True, index, index, cost=step * len(controls))


def main() -> None:
    """Add the parts that are missing."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problem")
    parser.add_argument("--num", type=int, default=1200, help=f"motions, in parts of {PART}")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True, help="folder of the demonstrations")
    options = parser.parse_args()
    plant = Plant(load_problem(options.problem))
    settings = {"problem": plant.problem.hash, "seed": options.seed}
    folder = DemoFolder(options.out, state_info(plant.problem), settings)
    for first in range(folder.next_index, options.num, PART):
        motions = polished_motions(plant, PART, np.random.default_rng([options.seed, first // PART]))
        episodes = [episode_of(motion, plant.dt, first + k) for k, motion in enumerate(motions)]
        folder.append(episodes, first + PART)
        print(f"{first + PART} motions", flush=True)


if __name__ == "__main__":
    main()
