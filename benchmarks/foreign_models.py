"""Plan over models that others wrote: DeepMind Control, Gymnasium, gymnasium-robotics and robosuite.

    pip download --no-deps dm_control gymnasium-robotics robosuite -d wheels
    for wheel in wheels/*.whl; do python -m zipfile -e $wheel models; done
    python benchmarks/foreign_models.py models

Every problem is planned for seeds 0 to 4 at default settings; a setting in a problem is shown in the table.
Each demonstration is replayed in the model that MuJoCo compiles from the user's own file, or, where joints
are held, in the model that the dataset holds.

The results are added to results/planning/foreign_models.csv problem by problem. A problem that the file
has is not planned for again. `--table` prints the table of docs/appendix/planning.md.
"""

import argparse
import time
import warnings
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import yaml
from csv_rows import read_rows, write_rows
from foreign_problems import PROBLEMS, Foreign

from planspace.errors import PlanspaceError
from planspace.physics.replay import replay
from planspace.plan.demonstrations import plan_demos

RESULTS = Path(__file__).parents[1] / "results" / "planning" / "foreign_models.csv"
GYM = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
COLUMNS = (
    "problem",
    "model",
    "distance",
    "settings",
    "solved",
    "seconds_per_plan",
    "duration_s",
    "replay_error",
)
NUM_SEEDS = 5


def main() -> None:
    """Plan for the problems that the results do not have yet."""
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="?", help="folder of the unpacked wheels")
    parser.add_argument("--table", action="store_true", help="print the table and do nothing else")
    parser.add_argument("--only", default="", help="plan only for problems whose name contains this")
    parser.add_argument("--seeds", type=int, default=NUM_SEEDS, help="number of plans per problem")
    parser.add_argument("--out", type=Path, default=RESULTS, help="CSV file of the results")
    options = parser.parse_args()
    rows = read_rows(options.out)
    if options.table:
        print(table(rows))
        return
    if options.models is None:
        parser.error("give the folder of the unpacked wheels")
    for name, problem in PROBLEMS.items():
        if options.only in name and name not in {row["problem"] for row in rows}:
            row = measure(name, problem, options.models, options.seeds)
            print(*(f"{row[column]}" for column in COLUMNS), sep="  ", flush=True)
            rows.append(row)
            write_rows(options.out, COLUMNS, rows)


def table(rows: list[dict[str, str]]) -> str:
    """The results as a Markdown table, in the order of the problems."""
    known = {row["problem"]: row for row in rows}
    lines = [
        "| problem | goal | settings | solved | seconds per plan | median duration [s] | replay error |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in (name for name in PROBLEMS if name in known):
        row = known[name]
        values = [row[key] for key in ("distance", "settings", "solved", *COLUMNS[-3:])]
        lines.append(f"| {' | '.join([name, *values])} |")
    return "\n".join(lines)


def measure(name: str, problem: Foreign, models: Path, num: int) -> dict[str, str]:
    """Plan for one problem and replay the demonstrations."""
    path = write_problem(name, problem, models)
    settings = "; ".join(
        key if isinstance(value, dict) else f"{key}: {value}".lower() for key, value in problem.more
    )
    row = {"problem": name, "model": problem.model, "distance": problem.why, "settings": settings}
    began = time.perf_counter()
    try:
        demos = plan_demos(path, num, seed=0, verbose=False)
    except PlanspaceError as error:
        seconds = (time.perf_counter() - began) / num
        print(name, error, flush=True)
        return row | {
            "solved": f"0/{num}",
            "seconds_per_plan": f"{seconds:.0f}",
            "duration_s": "",
            "replay_error": "",
        }
    seconds = (time.perf_counter() - began) / num
    model, space = demos.info.compile()
    if "held" not in dict(problem.more):
        content = yaml.safe_load(path.read_text())
        model = mujoco.MjModel.from_xml_path(str(path.parent / content["model"]))  # the user's own file
    errors, durations = [], []
    for i in range(len(demos)):
        episode = demos.episode(i)
        states = replay(model, space, episode.states[0], episode.controls, episode.times)
        errors.append(float(np.abs(space.difference(states, episode.states)).max()))
        durations.append(float(episode.times[-1]))
    return row | {
        "solved": f"{len(demos)}/{num}",
        "seconds_per_plan": f"{seconds:.0f}",
        "duration_s": f"{np.median(durations):.2f}",
        "replay_error": f"{max(errors):.1e}",
    }


def write_problem(name: str, problem: Foreign, models: Path) -> Path:
    """Write the problem file into the folder that holds all files of the model."""
    file = (
        GYM / problem.model.removeprefix("gym:")
        if problem.model.startswith("gym:")
        else models / problem.model
    )
    folder = models / "gym" if problem.model.startswith("gym:") else file.parents[1]
    if problem.model.startswith("gym:"):
        folder.mkdir(exist_ok=True)
        file = Path(folder / file.name)
        file.write_bytes((GYM / file.name).read_bytes())
    joints = problem.joints.split()
    content: dict[str, object] = {
        "model": str(file.relative_to(folder)),
        "joints": joints,
        "start": [*map(float, problem.start), *[0.0] * len(joints)],
        "goal": [*map(float, problem.goal), *[0.0] * len(joints)],
        "tolerance": 0.1,
        **dict(problem.more),
    }
    if problem.weights:
        counted = problem.weights.split()
        content["goal_weights"] = [float(joint in counted) for joint in joints] + [0.0] * len(joints)
    bounds = {j: {"low": [-5.0], "high": [5.0]} for j in joints if j in UNLIMITED_SLIDES}
    if bounds:
        content.setdefault("position_bounds", bounds)
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


UNLIMITED_SLIDES = ("rootx", "rootz", "slider1", "slider2", "ball_x", "ball_y")
"""Joints that have no limits in their models and get bounds of 5 m in the problem files."""

if __name__ == "__main__":
    main()
