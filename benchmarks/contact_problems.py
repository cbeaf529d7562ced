"""Planning through contact: the shipped problems with contacts, and locomotion of Gymnasium's models.

    python benchmarks/contact_problems.py                 # the shipped problems, seeds 0 to 4
    python benchmarks/contact_problems.py --locomotion    # 1 m ahead, seeds 0 to 2

Each plan is made at the default settings of its problem and replayed in the model that MuJoCo compiles from
the problem's own file. "Without shortcuts" is the median duration with `polish_shortcut_rounds` 0.
"""

import argparse
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import yaml

from planspace.demos.episode import Episode
from planspace.physics.replay import replay
from planspace.plan.config import PlanConfig
from planspace.plan.pipeline import Pipeline
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem

GYM = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
SHIPPED = ("hopper-stand", "pusher", "finger-spin", "cheetah-ahead")
LEGS = "thigh_joint leg_joint foot_joint"
LEFT = "thigh_left_joint leg_left_joint foot_left_joint"
SLIDES = {"rootx": {"low": [-2.0], "high": [5.0]}, "rootz": {"low": [-2.0], "high": [5.0]}}
LOCOMOTION = {
    "gym-hopper": ("hopper.xml", f"rootx rootz rooty {LEGS}", (0.0, 1.25, 0.0, 0.0, 0.0, 0.0)),
    "gym-walker": ("walker2d_v5.xml", f"rootx rootz rooty {LEGS} {LEFT}", (0.0, 1.25, *(0.0,) * 7)),
    "gym-cheetah": (
        "half_cheetah.xml",
        "rootx rootz rooty bthigh bshin bfoot fthigh fshin ffoot",
        (0.0,) * 9,
    ),
    "gym-ant": (
        "ant.xml",
        "root hip_1 ankle_1 hip_2 ankle_2 hip_3 ankle_3 hip_4 ankle_4",
        (0.0, 0.0, 0.75, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0),
    ),
}
"""Model, joints and first positions; velocities are 0."""


def locomotion_problem(name: str, folder: Path, metres: float, upright: bool) -> Problem:
    """The problem to move a model of Gymnasium ahead; its torso may fall unless it must stay upright."""
    file, joints, start = LOCOMOTION[name]
    (folder / file).write_bytes((GYM / file).read_bytes())
    num = 14 if name == "gym-ant" else len(start)
    root = {"root": {"low": [-2.0, -2.0, 0.0], "high": [5.0, 2.0, 3.0]}}
    tolerance = 0.3 if upright else 0.05
    content = {
        "model": file,
        "joints": joints.split(),
        "start": [*start, *(0.0,) * num],
        "goal": [metres + tolerance, *start[1:], *(0.0,) * num],
        "goal_weights": [1.0, *(0.0,) * (2 * num - 1)],
        "tolerance": tolerance,
        "hold": False,
        "limit_slack": 0.3,
        "position_bounds": root if name == "gym-ant" else SLIDES,
    }
    if upright:  # the height of the torso and its pitch, in which it must not fall
        content["goal_weights"] = [1.0, 1.0, 1.0, *(0.0,) * (2 * num - 3)]
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_problem(path)


def measure(name: str, problem: Problem, seeds: int, compare: bool, changes: dict[str, float]) -> str:
    """One row of the table."""
    config = PlanConfig.for_problem(problem, **changes)
    plain = replace(config, polish=replace(config.polish, shortcut_rounds=0))
    plans, seconds, before = [], [], []
    for seed in range(seeds):
        began = time.process_time()
        plans.append(Pipeline(problem, config, threads=0).plan(seed, 0))
        seconds.append(time.process_time() - began)
        if compare:
            before.append(Pipeline(problem, plain, threads=0).plan(seed, 0))
    solved = [plan for plan in plans if isinstance(plan, Episode)]
    missed = [plan.nearest for plan in plans if not isinstance(plan, Episode)]
    errors = [replay_error(problem, plan) for plan in solved]
    cells = [
        name,
        f"{len(solved)} of {seeds}",
        f"{np.mean(seconds):.1f} ({max(seconds):.1f})",
        _median([plan.times[-1] for plan in solved]),
        _median([plan.times[-1] for plan in before if isinstance(plan, Episode)]) if compare else "",
        f"{max(errors):.1e}" if errors else "",
        ", ".join(f"{distance:.2f}" for distance in missed),
    ]
    return f"| {' | '.join(cells)} |"


def replay_error(problem: Problem, plan: Episode) -> float:
    """The largest difference of any number of a state when a plan is replayed in plain MuJoCo."""
    _, space = problem.compile()
    own = mujoco.MjModel.from_xml_string(problem.source.text)
    states = replay(own, space, plan.states[0], plan.controls, plan.times)
    return float(np.abs(space.difference(states, plan.states)).max())


def _median(values: list[float]) -> str:
    return f"{np.median(values):.2f}" if values else ""


def main() -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="PROBLEM")
    parser.add_argument("--locomotion", action="store_true", help="Gymnasium's models, some metres ahead")
    parser.add_argument("--metres", type=float, default=1.0)
    parser.add_argument("--upright", action="store_true", help="the torso must also end upright")
    parser.add_argument("--seeds", type=int, default=None)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="settings of the planner")
    parser.add_argument("--compare", action="store_true", help="also plan without shortcuts")
    options = parser.parse_args()
    names = options.names or (LOCOMOTION if options.locomotion else SHIPPED)
    changes = {k: float(v) if "." in v else int(v) for k, v in (pair.split("=") for pair in options.set)}
    print(
        "| problem | solved | CPU seconds per plan (maximum) | median duration [s] | without shortcuts [s] "
        "| replay error | distance of failures |\n|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            if options.locomotion:
                problem = locomotion_problem(name, Path(folder), options.metres, options.upright)
            else:
                problem = load_problem(name)
            seeds = options.seeds or (3 if options.locomotion else 5)
            print(measure(name, problem, seeds, options.compare, changes), flush=True)


if __name__ == "__main__":
    main()
