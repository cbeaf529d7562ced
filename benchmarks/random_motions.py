r"""Fast motions between random states, as demonstrations.

    python benchmarks/random_motions.py cartpole-swingup --num 1200 --out motions
    planspace embed motions --time-head --time-hidden 256 256 --time-steps 12000 \
        --time-plan-weight 1000 --out z

Motions at full control begin at uniform states of the start box and are polished to the shortest duration
between their ends, as in `true_times.py --from-box`, with other random numbers. An embedding that is trained
on them knows times between more states than one that is trained on plans to one goal.

Parts of 100 motions are kept in DIR.parts, so the same command goes on.
"""

import argparse
from pathlib import Path

import numpy as np
from true_times import Plant, polished_motion

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
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


def keep(path: Path, motions: list[Trajectory]) -> None:
    """Save a part."""
    states = np.concatenate([motion.states for motion in motions])
    controls = np.concatenate([motion.controls for motion in motions])
    np.savez(path, states=states, controls=controls, steps=[len(motion.controls) for motion in motions])


def episodes_of(path: Path, step: float, first: int) -> list[Episode]:
    """The motions of a part as episodes, numbered from `first` on."""
    part = dict(np.load(path))
    ends = np.cumsum(part["steps"])
    controls = np.split(part["controls"], ends[:-1])
    states = np.split(part["states"], (ends + np.arange(1, len(ends) + 1))[:-1])
    return [
        Episode(x, u, step * np.arange(len(x)), x[-1], True, first + k, first + k, cost=step * len(u))
        for k, (x, u) in enumerate(zip(states, controls, strict=True))
    ]


def main() -> None:
    """Make the parts that are missing, and join them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problem")
    parser.add_argument("--num", type=int, default=1200, help=f"motions, in parts of {PART}")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True, help="folder of the demonstrations")
    options = parser.parse_args()
    plant = Plant(load_problem(options.problem))
    parts = options.out.with_suffix(".parts")
    parts.mkdir(parents=True, exist_ok=True)
    episodes: list[Episode] = []
    for k in range(-(-options.num // PART)):
        path = parts / f"part-{k:03d}.npz"
        if not path.exists():
            keep(path, polished_motions(plant, PART, np.random.default_rng([options.seed, k])))
            print(f"{(k + 1) * PART} motions", flush=True)
        episodes += episodes_of(path, plant.dt, len(episodes))
    Demos.from_episodes(state_info(plant.problem), episodes).save(options.out)


if __name__ == "__main__":
    main()
