"""Problem files in YAML, and the shipped problems; the layout of the 2020 planner is read too."""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from planspace.errors import PlanspaceError, UsageError, quoted, unknown
from planspace.mjcf.assets import ASSETS
from planspace.mjcf.compile import load_model
from planspace.mjcf.read import read_keyframe, read_model
from planspace.mjcf.source import ModelFile, ModelSource
from planspace.mjcf.subprocess_model import read_model_in_subprocess
from planspace.physics.space import DEFAULT_VELOCITY_BOUND
from planspace.tasks import problem_values as values
from planspace.tasks.check_problem import check_problem
from planspace.tasks.dm_control.suite import DMC_PREFIX, find_dmc_task
from planspace.tasks.problem import Box, Problem
from planspace.tasks.strict_yaml import read_yaml
from planspace.tasks.task_settings import TaskSettings
from planspace.tasks.task_values import task_settings

ReadModel = Callable[[ModelFile], ModelSource]
"""`read_model`, or its twin in a subprocess."""

TOLERANCE_2020 = 0.1
"""The goal tolerance of the 2020 planner, which its problem files do not name."""


KEYS_2020 = {
    "mujoco_config",
    "planner",
    "sst_selection_radius",
    "sst_pruning_radius",
    "start",
    "start_range",
    "goal",
    "time_limit",
}


def shipped_problems() -> list[str]:
    """Return the names of the problems that come with planspace."""
    return sorted(path.stem for path in ASSETS.glob("*.yaml"))


def load_problem(problem: str | Path | Problem, *, untrusted: bool = False) -> Problem:
    """Return a shipped problem, or read a problem file; the file layout of 2020 is read too.

    Args:
        problem: a name in `shipped_problems()`, a task of DeepMind Control such as `dmc:acrobot-swingup`, the
            path of a YAML file, or a problem, which is checked. A model that the file names must lie in the
            file's folder.
        untrusted: whether the file comes from strangers: its model is then read in a separate process, in
            bounded memory and time.

    Raises:
        UsageError: no problem has this name (the nearest is suggested), or the content of the file is wrong.
        PlanspaceError: the file or its model cannot be read.
    """
    if isinstance(problem, Problem):
        check_problem(problem, f"problem {problem.name}")
        return problem
    name = str(problem)
    if name in shipped_problems():
        return _read_problem(ASSETS / f"{name}.yaml")
    if name.startswith(DMC_PREFIX):
        return _problem_of_suite(name)
    if name.endswith((".yaml", ".yml")):
        return _read_problem(Path(name), read_model_in_subprocess if untrusted else read_model)
    raise unknown_name("problem", name, shipped_problems())


def unknown_name(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """The error for an unknown name, which may be a file without the ending of a problem file.

    Args:
        kind: what the name should be of.
        name: the name.
        known: the names that exist.
    """
    if Path(name).is_file():
        return UsageError(f"{name} is not a problem file: its name should end in .yaml.")
    if Path(f"{name}.yaml").is_file():
        return UsageError(f"unknown {kind} {quoted(name)}. Did you mean the problem file {name}.yaml?")
    return unknown(kind, name, known)


def _problem_of_suite(name: str) -> Problem:
    """The planning problem of a task of DeepMind Control."""
    problem = find_dmc_task(name).problem
    if not isinstance(problem, Problem):
        raise UsageError(f"{name} has no planning problem, because its goal is not a state.")
    return problem


def _read_problem(path: Path, read: ReadModel = read_model) -> Problem:
    settings = read_yaml(path)
    layout = _from_2020 if "mujoco_config" in settings else _from_keys
    try:
        problem = layout(path, settings, read)
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from error
    except PlanspaceError as error:
        if str(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from error
    check_problem(problem, str(path))
    return problem


def _from_keys(path: Path, settings: dict[str, Any], read: ReadModel) -> Problem:
    required = {"model", "joints", "start", "goal", "tolerance"}
    known = {f.name for f in fields(Problem)} - {"name", "goal_random", "predicate"} | required
    known |= {"held", "keyframe"}
    _check_keys(path, settings, known, required)
    joints = values.read(settings, "joints", values.names)
    file = ModelFile(
        _beside(path, values.read(settings, "model", values.text)),
        joints,
        root=path.parent,
        hold=values.read(settings, "held", values.held, ()),
        keyframe=values.read(settings, "keyframe", values.text, ""),
    )
    model = read(file)
    settings = _with_keyframes(settings, model, joints)
    goal, goal_random = values.read(settings, "goal", values.goal)
    return Problem(
        name=path.stem,
        model=model,
        joints=joints,
        start=values.read(settings, "start", values.box),
        goal=goal,
        goal_random=goal_random,
        tolerance=values.read(settings, "tolerance", values.positive),
        goal_weights=values.read(settings, "goal_weights", values.weights, ()),
        feature_weights=values.read(settings, "feature_weights", values.weights, ()),
        body_features=values.read(settings, "body_features", values.body_features, ()),
        sample_velocity=values.read(settings, "sample_velocity", values.speeds, ()),
        velocity_bound=values.read(settings, "velocity_bound", values.speeds, (DEFAULT_VELOCITY_BOUND,)),
        position_bounds=values.read(settings, "position_bounds", values.position_bounds, ()),
        limit_slack=values.read(settings, "limit_slack", values.positive, 0.0),
        control_bounds=values.read(settings, "control_bounds", values.box, None),
        forbidden_contacts=values.read(settings, "forbidden_contacts", values.contacts, "none"),
        hold=values.read(settings, "hold", values.flag, True),
        kinematic=values.read(settings, "kinematic", values.flag, False),
        cost=values.read(settings, "cost", values.cost, "duration"),
        planner=values.read(settings, "planner", values.text, "sst"),
        settings=values.read(settings, "settings", values.settings, ()),
        task=values.read(settings, "task", task_settings, TaskSettings()),
    )


def _with_keyframes(settings: dict[str, Any], model: ModelSource, joints: Sequence[str]) -> dict[str, Any]:
    """Replace a start or goal `{keyframe: NAME}` by the state of the keyframe; a goal has no activations."""
    found = dict(settings)
    for key in ("start", "goal"):
        if isinstance(value := settings.get(key), dict) and list(value) == ["keyframe"]:
            name = values.read(value, "keyframe", values.text)
            positions, velocities, activations = read_keyframe(model, joints, name)
            state = positions + velocities + (activations if key == "start" else [])
            found[key] = positions if settings.get("kinematic") is True else state
    return found


def _from_2020(path: Path, settings: dict[str, Any], read: ReadModel) -> Problem:
    """Read the layout of the 2020 planner.

    The state has all joints of the model, and starts lie within `start_range` of `start`. The radii and the
    time limit belong to OMPL's metric, so they become settings of OMPL's planners; ours has its own.
    """
    _check_keys(path, settings, KEYS_2020, {"mujoco_config", "start", "goal"})
    source = read(ModelFile(_beside(path, values.read(settings, "mujoco_config", values.text))))
    model = load_model(source)
    center = np.array(values.read(settings, "start", values.numbers))
    reach = np.abs(values.read(settings, "start_range", values.numbers, (0.0,) * len(center)))
    if len(reach) != len(center):
        raise ValueError(f"start_range: has {len(reach)} numbers, start has {len(center)}")
    ompl = {
        "selection_radius": values.read(settings, "sst_selection_radius", values.positive, None),
        "pruning_radius": values.read(settings, "sst_pruning_radius", values.positive, None),
        "seconds": values.read(settings, "time_limit", values.positive, None),
    }
    return Problem(
        name=path.stem,
        model=source,
        joints=tuple(model.joint(i).name for i in range(model.njnt)),
        start=Box(tuple((center - reach).tolist()), tuple((center + reach).tolist())),
        goal=values.read(settings, "goal", values.box),
        tolerance=TOLERANCE_2020,
        planner=_planner_2020(values.read(settings, "planner", values.text, "sst")),
        settings=tuple((f"ompl_{key}", value) for key, value in ompl.items() if value is not None),
    )


def _planner_2020(name: str) -> str:
    """Return our planner for SST, and OMPL's planner of this name otherwise."""
    return "sst" if name.lower() == "sst" else f"ompl-{name.lower()}"


def _check_keys(path: Path, settings: dict[str, Any], known: set[str], required: set[str]) -> None:
    for key in settings:
        if key not in known:
            raise UsageError(f"{path}: {unknown('key', str(key), known)}")
    missing = sorted(required - settings.keys())
    if missing:
        raise UsageError(f"{path}: the key {missing[0]!r} is missing.")


def _beside(path: Path, name: str) -> Path:
    """Return the path of a file that a problem file names, which must lie in its folder."""
    file = path.parent / name
    real = Path(os.path.realpath(file))  # realpath also ends where links form a circle
    if not real.is_relative_to(os.path.realpath(path.parent)):
        raise UsageError(f"{path} refers to {name!r}, outside its folder; copy it next to the problem file.")
    return file
