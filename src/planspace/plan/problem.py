"""Planning problems: a model, where plans start, where they end. YAML, read strictly."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
from jaxtyping import Float

from planspace.errors import PlanspaceError, UsageError, unknown
from planspace.physics.simulate import ASSETS, load_model
from planspace.physics.space import DEFAULT_VELOCITY_BOUND, StateSpace
from planspace.store import json_hash, read_bytes

MAX_FILE_BYTES = 1 << 20


@dataclass(frozen=True)
class Box:
    """A box of states; a point where low equals high."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def sample(self, rng: np.random.Generator) -> Float[np.ndarray, " state"]:
        """Draws a state uniformly."""
        return rng.uniform(self.low, self.high)


@dataclass(frozen=True)
class Problem:
    """What to plan. Sizes: n joints make a state of 2 n numbers, positions first."""

    name: str
    """What it is called in manifests and messages."""
    mjcf: str
    """The model's MJCF text."""
    joints: tuple[str, ...]
    """The joints that make the state, in order."""
    start: Box
    """Where plans start [m, rad, m/s, rad/s]."""
    goal: Box
    """Where plans end; drawn anew for each plan if it is more than a point."""
    tolerance: float
    """A plan has arrived when the sum of absolute differences to its goal is at most this."""
    feature_weights: tuple[float, ...]
    """How much each number of a state counts when neighbours are searched."""
    sample_velocity: tuple[float, ...]
    """Exploration draws each joint's velocity within plus or minus these [m/s or rad/s]."""
    velocity_bound: float = DEFAULT_VELOCITY_BOUND
    """Faster states are out of bounds [m/s or rad/s]."""

    def compile(self) -> tuple[mujoco.MjModel, StateSpace]:
        """Compiles the model and reads its state space."""
        model = load_model(self.mjcf)
        return model, StateSpace.from_model(model, self.joints, velocity_bound=self.velocity_bound)

    @property
    def hash(self) -> str:
        """SHA-256 of everything that defines the problem."""
        return json_hash({f.name: _plain(getattr(self, f.name)) for f in fields(self)})


def shipped_problems() -> list[str]:
    """Names of the problems that come with planspace."""
    return sorted(path.stem for path in ASSETS.glob("*.yaml"))


def load_problem(name_or_file: str) -> Problem:
    """Reads a shipped problem by name, or a problem file.

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
    known = {f.name for f in fields(Problem)} - {"name", "mjcf"} | {"model"}
    for key in settings:
        if key not in known:
            raise PlanspaceError(f"{path}: {unknown('key', str(key), known)}")
    missing = known - settings.keys() - {"velocity_bound"}
    if missing:
        raise PlanspaceError(f"{path}: the key {sorted(missing)[0]!r} is missing.")
    try:
        problem = Problem(
            name=path.stem,
            mjcf=read_bytes(path.parent / str(settings["model"])).decode(),
            joints=tuple(str(name) for name in settings["joints"]),
            start=_box(settings["start"]),
            goal=_box(settings["goal"]),
            tolerance=float(settings["tolerance"]),
            feature_weights=_numbers(settings["feature_weights"]),
            sample_velocity=_numbers(settings["sample_velocity"]),
            velocity_bound=float(settings.get("velocity_bound", DEFAULT_VELOCITY_BOUND)),
        )
    except (TypeError, ValueError, KeyError) as error:
        raise PlanspaceError(f"{path}: {error}") from error
    _check(problem, path)
    return problem


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
        _, space = problem.compile()
    except PlanspaceError as error:
        raise UsageError(f"{path}: {error}") from error
    sizes = {
        "start": (len(problem.start.low), space.size),
        "goal": (len(problem.goal.low), space.size),
        "feature_weights": (len(problem.feature_weights), space.size),
        "sample_velocity": (len(problem.sample_velocity), len(space.joints)),
    }
    for key, (got, wanted) in sizes.items():
        if got != wanted:
            raise PlanspaceError(f"{path}: {key} has {got} numbers, the state needs {wanted}.")
    for key, box in (("start", problem.start), ("goal", problem.goal)):
        if not space.in_bounds(np.array([box.low, box.high])).all():
            raise PlanspaceError(f"{path}: {key} reaches outside the joint limits or the velocity bound.")


def _box(value: Any) -> Box:
    if isinstance(value, dict):
        low, high = _numbers(value["low"]), _numbers(value["high"])
    else:
        low = high = _numbers(value)
    if len(low) != len(high) or any(a > b for a, b in zip(low, high, strict=True)):
        raise ValueError(f"a box needs low <= high, number by number; got {low} and {high}")
    return Box(low, high)


def _numbers(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise TypeError(f"expected a list of numbers, got {value!r}")
    return tuple(float(v) for v in value)


def _plain(value: Any) -> Any:
    return {"low": value.low, "high": value.high} if isinstance(value, Box) else value
