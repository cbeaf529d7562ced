"""Problem files: YAML, read strictly, and the layout of 2020."""

from dataclasses import fields
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
import yaml

from planspace.errors import PlanspaceError, UsageError, unknown
from planspace.physics.mjcf import read_model
from planspace.physics.simulate import ASSETS, GeomPairs, control_bounds, load_model
from planspace.physics.space import DEFAULT_VELOCITY_BOUND, StateSpace
from planspace.plan.problem import Box, Problem
from planspace.store import read_bytes

MAX_FILE_BYTES = 1 << 20
TOLERANCE_2020 = 0.1
"""The goal threshold of the 2020 planner, which its problem files do not name."""


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
    """Names of the problems that come with planspace."""
    return sorted(path.stem for path in ASSETS.glob("*.yaml"))


def load_problem(name_or_file: str) -> Problem:
    """Reads a shipped problem by name, or a problem file; the layout of 2020 is understood too.

    Args:
        name_or_file: a name of `shipped_problems()`, or the path of a YAML file; a model named in a file
            is looked for beside it.

    Raises:
        UsageError: no such problem (the nearest name is suggested), or an unknown key.
        PlanspaceError: the file, or the model it names, cannot be read or does not fit.
    """
    if name_or_file in shipped_problems():
        return _read_problem(ASSETS / f"{name_or_file}.yaml")
    if name_or_file.endswith((".yaml", ".yml")):
        return _read_problem(Path(name_or_file))
    raise unknown("problem", name_or_file, shipped_problems())


def _read_problem(path: Path) -> Problem:
    settings = _read_yaml(path)
    try:
        problem = _from_2020(path, settings) if "mujoco_config" in settings else _from_keys(path, settings)
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise PlanspaceError(f"{path}: {error}") from error
    _check(problem, path)
    return problem


def _from_keys(path: Path, settings: dict[str, Any]) -> Problem:
    required = {"model", "joints", "start", "goal", "tolerance"}
    known = {f.name for f in fields(Problem)} - {"name", "mjcf", "goal_random", "predicate"} | required
    _check_keys(path, settings, known, required)
    joints = tuple(str(name) for name in settings["joints"])
    goal = settings["goal"]
    bound = settings.get("velocity_bound", DEFAULT_VELOCITY_BOUND)
    return Problem(
        name=path.stem,
        mjcf=read_model(_beside(path, str(settings["model"])), joints),
        joints=joints,
        start=_box(settings["start"]),
        goal=_box(goal),
        goal_random=isinstance(goal, dict) and _flag(goal, "random", False),
        tolerance=float(settings["tolerance"]),
        goal_weights=_numbers(settings.get("goal_weights", [])),
        feature_weights=_numbers(settings.get("feature_weights", [])),
        sample_velocity=_numbers(settings.get("sample_velocity", [])),
        velocity_bound=_numbers(bound if isinstance(bound, list) else [bound]),
        position_bounds=tuple(
            (str(name), *_sides(value)) for name, value in settings.get("position_bounds", {}).items()
        ),
        control_bounds=_box(settings["control_bounds"]) if "control_bounds" in settings else None,
        forbidden_contacts=_contacts(settings.get("forbidden_contacts", "none")),
        hold=_flag(settings, "hold", True),
        kinematic=_flag(settings, "kinematic", False),
        cost=_cost(settings.get("cost", "duration")),
        planner=str(settings.get("planner", "sst")),
        settings=tuple(sorted(dict(settings.get("settings", {})).items())),
    )


def _from_2020(path: Path, settings: dict[str, Any]) -> Problem:
    """Reads the layout of the 2020 planner.

    All joints of the model are planned for, starts lie within `start_range` of `start`. The radii and the
    time limit belong to OMPL's metric and planner, so they go to that one; ours takes its own settings.
    """
    _check_keys(path, settings, KEYS_2020, {"mujoco_config", "start", "goal"})
    mjcf = read_model(_beside(path, str(settings["mujoco_config"])))
    model = load_model(mjcf)
    center = np.array(_numbers(settings["start"]))
    reach = np.abs(_numbers(settings.get("start_range", [0.0] * len(center))))
    ompl = {
        "selection_radius": settings.get("sst_selection_radius"),
        "pruning_radius": settings.get("sst_pruning_radius"),
        "seconds": settings.get("time_limit"),
    }
    return Problem(
        name=path.stem,
        mjcf=mjcf,
        joints=tuple(model.joint(i).name for i in range(model.njnt)),
        start=Box(tuple((center - reach).tolist()), tuple((center + reach).tolist())),
        goal=_box(settings["goal"]),
        tolerance=TOLERANCE_2020,
        planner=_planner_2020(str(settings.get("planner", "sst"))),
        settings=tuple((f"ompl_{key}", float(value)) for key, value in ompl.items() if value is not None),
    )


def _planner_2020(name: str) -> str:
    """Ours where the file asks for SST, else OMPL's of that name."""
    return "sst" if name.lower() == "sst" else f"ompl-{name.lower()}"


def _check_keys(path: Path, settings: dict[str, Any], known: set[str], required: set[str]) -> None:
    for key in settings:
        if key not in known:
            raise UsageError(f"{path}: {unknown('key', str(key), known)}")
    missing = sorted(required - settings.keys())
    if missing:
        raise PlanspaceError(f"{path}: the key {missing[0]!r} is missing.")


def _beside(path: Path, name: str) -> Path:
    """A file named in a problem file, which must lie in its folder."""
    file = path.parent / name
    if not file.resolve().is_relative_to(path.parent.resolve()):
        raise PlanspaceError(
            f"{path} refers to {name!r}, outside its folder; copy it beside the problem file."
        )
    return file


def _read_yaml(path: Path) -> dict[str, Any]:
    data = read_bytes(path)
    if len(data) > MAX_FILE_BYTES:
        raise PlanspaceError(f"{path} has {len(data)} bytes; a problem file has at most {MAX_FILE_BYTES}.")
    try:
        settings = yaml.safe_load(data)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise PlanspaceError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(settings, dict):
        raise PlanspaceError(f"{path} should hold keys and values, got a {type(settings).__name__}.")
    return settings


def _check(problem: Problem, path: Path) -> None:
    try:
        model, space = problem.compile()
    except PlanspaceError as error:
        raise UsageError(f"{path}: {error}") from error
    controls = space.num_dofs if space.kinematic else model.nu
    sizes = [
        ("start", problem.start.low, space.size),
        ("goal", problem.goal.low, space.size),
        ("goal_weights", problem.goal_weights, space.tangent_size),
        ("feature_weights", problem.feature_weights, space.tangent_size),
        ("sample_velocity", problem.sample_velocity, space.num_dofs),
        ("control_bounds", problem.control_bounds.low if problem.control_bounds else (), controls),
    ]
    for key, got, wanted in sizes:
        if len(got) not in ((wanted,) if key in ("start", "goal") else (0, wanted)):
            raise PlanspaceError(f"{path}: {key} has {len(got)} numbers, {wanted} are needed.")
    for key, box in (("start", problem.start), ("goal", problem.goal)):
        if not space.in_bounds(space.normalise(np.array([box.low, box.high]))).all():
            raise PlanspaceError(f"{path}: {key} reaches outside the joint limits or the velocity bound.")
    _check_finite(problem, model, space, path)


def _check_finite(problem: Problem, model: mujoco.MjModel, space: StateSpace, path: Path) -> None:
    """A planner draws positions and controls, so all of them need bounds."""
    if model.nu == 0 and not space.kinematic:
        raise PlanspaceError(
            f"{path}: no actuator is left that moves its joints; there is nothing to control."
        )
    if not np.isfinite(control_bounds(model, space)).all():
        raise PlanspaceError(f"{path}: an actuator has no control range; give control_bounds.")
    for joint, kind in zip(space.joints, space.kinds, strict=True):
        part = StateSpace.from_model(
            model,
            [joint],
            position_bounds={n: (a, b) for n, a, b in problem.position_bounds if n == joint},
        )
        numbers = {"slide": 1, "hinge": 1, "free": 3}.get(kind, 0)
        if not (np.isfinite(part.low[:numbers]).all() and np.isfinite(part.high[:numbers]).all()):
            raise PlanspaceError(f"{path}: joint {joint!r} has no limits; give it position_bounds.")


def _box(value: Any) -> Box:
    low, high = _sides(value) if isinstance(value, dict) else (_numbers(value), _numbers(value))
    return Box(low, high)


def _sides(value: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    for key in value:
        if key not in ("low", "high", "random"):
            raise ValueError(str(unknown("key of a box", str(key), ["low", "high", "random"])))
    low, high = _numbers(value["low"]), _numbers(value["high"])
    if len(low) != len(high) or any(a > b for a, b in zip(low, high, strict=True)):
        raise ValueError(f"a box needs low <= high, number by number; got {low} and {high}")
    return low, high


def _contacts(value: Any) -> Literal["none", "all"] | GeomPairs:
    if value in ("none", "all"):
        return value
    pairs = () if isinstance(value, str) else tuple(tuple(str(name) for name in pair) for pair in value)
    if not pairs or any(len(pair) != 2 for pair in pairs):
        raise ValueError("forbidden_contacts is none, all, or a list of pairs of geoms")
    return pairs  # pyright: ignore[reportReturnType]


def _cost(value: Any) -> Literal["duration", "effort"]:
    if value not in ("duration", "effort"):
        raise ValueError(str(unknown("cost", str(value), ["duration", "effort"])))
    return value


def _flag(settings: dict[str, Any], key: str, default: bool) -> bool:
    value = settings.get(key, default)
    if not isinstance(value, bool):
        raise TypeError(f"{key} is true or false, got {value!r}")
    return value


def _numbers(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise TypeError(f"expected a list of numbers, got {value!r}")
    numbers = tuple(float(v) for v in value)
    if not np.isfinite(numbers).all():
        raise ValueError(f"expected finite numbers, got {value!r}")
    return numbers
