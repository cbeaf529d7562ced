"""Problem files: YAML, read strictly, and the layout of 2020."""

import math
import os
import reprlib
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
import yaml

from planspace.errors import PlanspaceError, UsageError, unknown
from planspace.mjcf.assets import ASSETS
from planspace.mjcf.compile import GeomPairs, load_model
from planspace.mjcf.read import read_model
from planspace.mjcf.subprocess_model import read_model_in_subprocess
from planspace.physics.simulator import Simulator, control_bounds
from planspace.physics.space import DEFAULT_VELOCITY_BOUND, StateSpace
from planspace.storage.files import read_bytes
from planspace.tasks.problem import Box, Problem

ReadModel = Callable[[Path, Sequence[str] | None], str]

MAX_FILE_BYTES = 1 << 17
"""PyYAML takes seconds for so much, whatever it is."""
MAX_TEXT = 4096
"""Characters of a key or a value, no fewer than of a path; PyYAML takes long for long numbers with colons."""
MAX_SETTING = 100_000
"""Of a planner, in a file; whoever wants a longer search says so on the command line."""
MERGE_TAG = "tag:yaml.org,2002:merge"
MAX_SHOWN = 80
"""Characters of a value in a message."""
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


def load_problem(problem: str | Path | Problem, *, untrusted: bool = False) -> Problem:
    """Return a shipped problem, or read a problem file; the file layout of 2020 is read too.

    Args:
        problem: a name in `shipped_problems()`, the path of a YAML file, or a problem, which is returned as
            it is. A model that the file names must lie in the file's folder.
        untrusted: whether the file comes from strangers: its model is then read in a separate process, in
            bounded memory and time.

    Raises:
        UsageError: no problem has this name (the nearest one is suggested), or a key is unknown.
        PlanspaceError: the file or its model cannot be read, or they do not fit each other.
    """
    if isinstance(problem, Problem):
        return problem
    name = str(problem)
    if name in shipped_problems():
        return _read_problem(ASSETS / f"{name}.yaml")
    if name.endswith((".yaml", ".yml")):
        return _read_problem(Path(name), read_model_in_subprocess if untrusted else read_model)
    if Path(name).is_file():
        raise UsageError(f"{name} is not a problem file: its name should end in .yaml.")
    raise unknown("problem", name, shipped_problems())


def _read_problem(path: Path, read: ReadModel = read_model) -> Problem:
    settings = _read_yaml(path)
    layout = _from_2020 if "mujoco_config" in settings else _from_keys
    try:
        problem = layout(path, settings, read)
    except ValueError as error:
        raise PlanspaceError(f"{path}: {error}") from error
    _check(problem, path)
    return problem


def _from_keys(path: Path, settings: dict[str, Any], read: ReadModel) -> Problem:
    required = {"model", "joints", "start", "goal", "tolerance"}
    known = {f.name for f in fields(Problem)} - {"name", "mjcf", "goal_random", "predicate"} | required
    _check_keys(path, settings, known, required)
    joints = _read(settings, "joints", _names)
    goal, goal_random = _read(settings, "goal", _goal)
    return Problem(
        name=path.stem,
        mjcf=read(_beside(path, _read(settings, "model", _text)), joints),
        joints=joints,
        start=_read(settings, "start", _box),
        goal=goal,
        goal_random=goal_random,
        tolerance=_read(settings, "tolerance", _positive),
        goal_weights=_read(settings, "goal_weights", _weights, ()),
        feature_weights=_read(settings, "feature_weights", _weights, ()),
        sample_velocity=_read(settings, "sample_velocity", _speeds, ()),
        velocity_bound=_read(settings, "velocity_bound", _speeds, (DEFAULT_VELOCITY_BOUND,)),
        position_bounds=_read(settings, "position_bounds", _position_bounds, ()),
        control_bounds=_read(settings, "control_bounds", _box, None),
        forbidden_contacts=_read(settings, "forbidden_contacts", _contacts, "none"),
        hold=_read(settings, "hold", _flag, True),
        kinematic=_read(settings, "kinematic", _flag, False),
        cost=_read(settings, "cost", _cost, "duration"),
        planner=_read(settings, "planner", _text, "sst"),
        settings=_read(settings, "settings", _settings, ()),
    )


def _from_2020(path: Path, settings: dict[str, Any], read: ReadModel) -> Problem:
    """Reads the layout of the 2020 planner.

    All joints of the model are planned for, starts lie within `start_range` of `start`. The radii and the
    time limit belong to OMPL's metric and planner, so they go to that one; ours takes its own settings.
    """
    _check_keys(path, settings, KEYS_2020, {"mujoco_config", "start", "goal"})
    mjcf = read(_beside(path, _read(settings, "mujoco_config", _text)), None)
    model = load_model(mjcf)
    center = np.array(_read(settings, "start", _numbers))
    reach = np.abs(_read(settings, "start_range", _numbers, (0.0,) * len(center)))
    if len(reach) != len(center):
        raise ValueError(f"start_range: has {len(reach)} numbers, start has {len(center)}")
    ompl = {
        "selection_radius": _read(settings, "sst_selection_radius", _positive, None),
        "pruning_radius": _read(settings, "sst_pruning_radius", _positive, None),
        "seconds": _read(settings, "time_limit", _positive, None),
    }
    return Problem(
        name=path.stem,
        mjcf=mjcf,
        joints=tuple(model.joint(i).name for i in range(model.njnt)),
        start=Box(tuple((center - reach).tolist()), tuple((center + reach).tolist())),
        goal=_read(settings, "goal", _box),
        tolerance=TOLERANCE_2020,
        planner=_planner_2020(_read(settings, "planner", _text, "sst")),
        settings=tuple((f"ompl_{key}", value) for key, value in ompl.items() if value is not None),
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
    if not Path(os.path.realpath(file)).is_relative_to(os.path.realpath(path.parent)):  # of a circle, too
        raise PlanspaceError(
            f"{path} refers to {name!r}, outside its folder; copy it beside the problem file."
        )
    return file


def _read_yaml(path: Path) -> dict[str, Any]:
    data = read_bytes(path, most=MAX_FILE_BYTES, may_be_link=True)
    try:
        settings = yaml.load(data, Loader=_StrictLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise PlanspaceError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(settings, dict):
        raise PlanspaceError(f"{path} should hold keys and values, got a {type(settings).__name__}.")
    if not all(isinstance(key, str) for key in settings):
        raise PlanspaceError(f"{path} should hold keys that are names, got {_short(list(settings))}.")
    return settings


class _StrictLoader(yaml.SafeLoader):
    """YAML's safe loader, which takes no key twice, no keys of another mapping, and no endless text."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Refuses a key that came before, and one that stands for others, which can be keys without end."""
        keys: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == MERGE_TAG:
                raise yaml.constructor.ConstructorError(None, None, "a key is no plain text", key.start_mark)
            if key.value in keys:
                raise yaml.constructor.ConstructorError(None, None, f"the key {key.value!r} comes twice")
            keys.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_scalar(self, node: yaml.ScalarNode | yaml.MappingNode) -> Any:
        """Refuses a text that is too long, before a number is made of it."""
        if len(node.value) > MAX_TEXT:
            problem = f"a text of {len(node.value)} characters; {MAX_TEXT} may be"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return super().construct_scalar(node)


def _check(problem: Problem, path: Path) -> None:
    try:
        model, space = problem.compile()
    except PlanspaceError as error:
        raise UsageError(f"{path}: {error}") from error
    sizes = [
        ("start", problem.start.low, space.size),
        ("goal", problem.goal.low, space.size),
        ("goal_weights", problem.goal_weights, space.tangent_size),
        ("feature_weights", problem.feature_weights, space.tangent_size),
        ("sample_velocity", problem.sample_velocity, space.num_dofs),
    ]
    for key, got, wanted in sizes:
        if len(got) not in ((wanted,) if key in ("start", "goal") else (0, wanted)):
            raise PlanspaceError(f"{path}: {key} has {len(got)} numbers, {wanted} are needed.")
    for key, box in (("start", problem.start), ("goal", problem.goal)):
        if not space.in_bounds(space.normalise(np.array([box.low, box.high]))).all():
            raise PlanspaceError(f"{path}: {key} reaches outside the joint limits or the velocity bound.")
    if model.nu == 0 and not space.kinematic:
        raise PlanspaceError(
            f"{path}: no actuator is left that moves its joints; there is nothing to control."
        )
    if not np.isfinite(control_bounds(model, space)).all():
        raise PlanspaceError(f"{path}: an actuator has no control range; give control_bounds.")
    free = [space.names[s] for s in space.unbounded]
    if free:
        raise PlanspaceError(f"{path}: {free[0]!r} has no limits; give its joint position_bounds.")
    _check_goal(problem, model, space, path)


def _check_goal(problem: Problem, model: mujoco.MjModel, space: StateSpace, path: Path) -> None:
    """A goal that is no target, or that nothing may enter, is said before a search is wasted on it."""
    if problem.goal_random:
        return
    for column in space.quaternion_columns:
        if problem.goal.low[column : column + 4] != problem.goal.high[column : column + 4]:
            raise PlanspaceError(
                f"{path}: goal: a box cannot span rotations; leave directions free by goal_weights."
            )
    simulator = Simulator(model, space, 1, threads=1, validity=problem.validity)
    center = problem.draw_goal(space, np.random.default_rng(0)).center
    if not simulator.valid_states(center[None])[0]:
        raise PlanspaceError(f"{path}: goal: it is in collision, or the predicate refuses it.")


# --- one value ---------------------------------------------------------------------------------------

_REQUIRED = object()


def _read(settings: dict[str, Any], key: str, reader: Callable[[Any], Any], default: Any = _REQUIRED) -> Any:
    """One value, or its default; what is wrong with it is said with its key.

    Raises:
        ValueError: it cannot be read.
    """
    if key not in settings and default is not _REQUIRED:
        return default
    try:
        return reader(settings[key])
    except KeyError as error:
        raise ValueError(f"{key}: it has no {error}") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ValueError(f"{key}: {error}") from error


def _box(value: Any) -> Box:
    low, high = _sides(value) if isinstance(value, dict) else (_numbers(value), _numbers(value))
    return Box(low, high)


def _goal(value: Any) -> tuple[Box, bool]:
    """The box, and whether a goal is drawn from it."""
    if not isinstance(value, dict):
        return _box(value), False
    return _box({k: v for k, v in value.items() if k != "random"}), _flag(value.get("random", False))


def _sides(value: dict[str, Any]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    for key in value:
        if key not in ("low", "high"):
            raise ValueError(str(unknown("key of a box", str(key), ["low", "high"])))
    low, high = _numbers(value["low"]), _numbers(value["high"])
    if len(low) != len(high) or any(a > b for a, b in zip(low, high, strict=True)):
        raise ValueError(f"a box needs low <= high, number by number; got {_short(value)}")
    return low, high


def _position_bounds(value: Any) -> tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...]:
    return tuple((str(name), *_sides(box)) for name, box in value.items())


def _contacts(value: Any) -> Literal["none", "all"] | GeomPairs:
    if value in ("none", "all"):
        return value
    pairs = tuple(_names(pair) for pair in value) if isinstance(value, list) else ()
    if not pairs or any(len(pair) != 2 for pair in pairs):
        raise ValueError("it is none, all, or a list of pairs of geoms")
    return pairs  # pyright: ignore[reportReturnType]


def _settings(value: Any) -> tuple[tuple[str, Any], ...]:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise TypeError(f"expected keys and values, got {_short(value)}")
    for key, setting in value.items():
        if not isinstance(setting, str) and not abs(_number(setting)) <= MAX_SETTING:
            raise ValueError(f"{key} may be up to {MAX_SETTING}, got {_short(setting)}")
    return tuple(sorted(value.items()))


def _cost(value: Any) -> Literal["duration", "effort"]:
    if _text(value) not in ("duration", "effort"):
        raise ValueError(str(unknown("cost", value, ["duration", "effort"])))
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"it is true or false, got {_short(value)}")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"expected a name, got {_short(value)}")
    return value


def _names(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not value:
        raise TypeError(f"expected a list of names, got {_short(value)}")
    return tuple(_text(name) for name in value)


def _numbers(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise TypeError(f"expected a list of numbers, got {_short(value)}")
    return tuple(_number(v) for v in value)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"expected finite numbers, got {_short(value)}")
    return float(value)


def _positive(value: Any) -> float:
    if not _number(value) > 0:
        raise ValueError(f"it must be positive, got {_short(value)}")
    return float(value)


def _weights(value: Any) -> tuple[float, ...]:
    if any(number < 0 for number in _numbers(value)):
        raise ValueError(f"weights are not negative, got {_short(value)}")
    return _numbers(value)


def _speeds(value: Any) -> tuple[float, ...]:
    speeds = _numbers(value if isinstance(value, list) else [value])
    if any(number <= 0 for number in speeds):
        raise ValueError(f"speeds are positive, got {_short(value)}")
    return speeds


def _short(value: Any) -> str:
    """A value for a message: YAML's aliases can make a small file's value endless."""
    return reprlib.repr(value)[:MAX_SHOWN]
