"""Describe and validate a dataset."""

from collections.abc import Iterator
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np

from planspace.demos.convert import load_source
from planspace.demos.dataset import Demos
from planspace.demos.formats.registry import find_format
from planspace.demos.manifest import DatasetSettings
from planspace.demos.stored import StoredDemos
from planspace.errors import PlanspaceError
from planspace.mjcf.subprocess_model import check_compiles
from planspace.physics.replay import replay
from planspace.progress import progress_over

REPLAY_TOLERANCE = 1e-6
"""Largest accepted difference of a replayed state [m, rad, m/s, rad/s]."""
LARGEST_NUMBER = 1e10
"""MuJoCo treats a state with larger numbers as diverged (its mjMAXVAL)."""


class Spread(TypedDict):
    """Range of a quantity over demonstrations."""

    min: float
    median: float
    max: float


class SearchTrees(TypedDict):
    """The search trees of a dataset, if they were kept."""

    search_trees: NotRequired[dict[str, int]]
    """Number of trees and of their nodes."""


class Description(SearchTrees):
    """The content of a dataset."""

    demonstrations: int
    states: int
    reached_goal: int
    """Number of demonstrations that end at their goal."""
    state: dict[str, str]
    """Unit of each state, by name."""
    circular: list[str]
    """States that are angles on a circle."""
    controls: int
    problem: str
    made_by: DatasetSettings
    """The planner and seed, or the imported source."""
    states_per_demonstration: Spread
    duration_s: Spread
    hash: str


class Validation(TypedDict):
    """The result of `validate`."""

    demonstrations: int
    hash: str
    replay_error: NotRequired[float]
    """Largest difference between recorded and replayed states, if controls were replayed."""


def describe(folder: Path) -> Description:
    """Count and summarise the demonstrations of a dataset.

    Args:
        folder: the folder of the dataset, or `minari:ID`.

    Raises:
        PlanspaceError: the dataset cannot be read.
    """
    demos = _open(folder)
    info, reached = demos.info, 0
    numbers, times = [], []
    for _, part in _parts(demos):
        numbers.append(np.diff(part.offsets))
        times.append(part.times[part.offsets[1:] - 1])
        reached += int(part.success.sum())
    lengths, durations = np.concatenate(numbers), np.concatenate(times)
    return {
        "demonstrations": len(demos),
        "states": int(lengths.sum()),
        "reached_goal": reached,
        "state": dict(zip(info.names, info.units, strict=True)),
        "circular": [info.names[c] for c in info.circular_columns],
        "controls": info.num_controls,
        "problem": info.problem,
        "made_by": _origin(demos, folder),
        "states_per_demonstration": _spread(lengths),
        "duration_s": _spread(durations),
        **_trees(demos),
        "hash": demos.hash,
    }


def validate(folder: Path, *, replay_controls: bool, untrusted: bool = False) -> Validation:
    """Check the hashes, numbers and times of a dataset, and optionally replay its controls.

    Args:
        folder: the folder of the dataset, or `minari:ID`.
        replay_controls: whether to simulate the controls and compare the states.
        untrusted: whether to compile the model in a separate process first.

    Raises:
        PlanspaceError: a check failed; the message names the shard or demonstration.
    """
    demos = _open(folder)
    if replay_controls and untrusted:
        check_compiles(demos.info.source or "")
    worst = 0.0
    for first, part in progress_over(_parts(demos), "validate", unit="shard"):
        _check_numbers(part, first, folder)
        _check_times(part, first, folder)
        if replay_controls:
            worst = max(worst, _check_replay(part, first, folder))
    found = Validation(demonstrations=len(demos), hash=demos.hash)
    if replay_controls:
        found["replay_error"] = worst
    return found


def _check_numbers(part: Demos, first: int, folder: Path) -> None:
    for i in range(len(part)):
        e = part.episode(i)
        numbers = {"state": e.states, "control": e.controls, "goal": e.goal, "cost": np.array([e.cost])}
        for name, values in numbers.items():
            large = values[np.abs(values) > LARGEST_NUMBER]  # unknown goals and costs are NaN
            if len(large):
                raise PlanspaceError(
                    f"{folder}: demonstration {first + i} has a {name} with the value "
                    f"{large[0]:.3g}; absolute values must not exceed {LARGEST_NUMBER:.0e}."
                )


def _check_times(part: Demos, first: int, folder: Path) -> None:
    for i in range(len(part)):
        if (np.diff(part.episode(i).times) <= 0).any():
            raise PlanspaceError(f"{folder}: the times of demonstration {first + i} do not increase.")


def _check_replay(part: Demos, first: int, folder: Path) -> float:
    errors = replay_errors(part)
    if not errors.max() <= REPLAY_TOLERANCE:  # `not <=` because it is NaN if the simulation diverges
        raise PlanspaceError(
            f"{folder}: replaying the controls of demonstration {first + int(errors.argmax())} gives states "
            f"that differ by up to {errors.max():.2g}: it was recorded with another model or version of "
            "MuJoCo, or a control was not held from its state to the next."
        )
    return float(errors.max())


def replay_errors(demos: Demos) -> np.ndarray:
    """Largest difference between recorded and replayed states, for each demonstration.

    Raises:
        PlanspaceError: the dataset has no model, or its controls are not those of the model.
    """
    model, space = demos.info.compile()
    if not space.kinematic and demos.info.num_controls != model.nu:
        raise PlanspaceError(
            f"the controls have {demos.info.num_controls} numbers, but the model has {model.nu} actuators; "
            "they cannot be replayed."
        )
    errors = []
    for i in range(len(demos)):
        e = demos.episode(i)
        states = replay(model, space, e.states[0], e.controls, e.times)
        errors.append(np.abs(states - e.states).max())
    return np.array(errors)


def _open(folder: Path) -> Demos | StoredDemos:
    fmt = find_format(str(folder))
    return load_source(str(folder)) if fmt and not fmt.is_file else StoredDemos(folder)


def _parts(demos: Demos | StoredDemos) -> Iterator[tuple[int, Demos]]:
    """Each shard in turn, with the number of its first demonstration."""
    first = 0
    for part in [demos] if isinstance(demos, Demos) else demos.shards():
        yield first, part
        first += len(part)


def _origin(demos: Demos | StoredDemos, folder: Path) -> DatasetSettings:
    """The planner and seed, or the imported source."""
    if isinstance(demos, Demos):
        return {"imported": str(folder)}
    settings, origin = demos.settings, DatasetSettings()
    if "planner" in settings:
        origin["planner"] = settings["planner"]
    if "seed" in settings:
        origin["seed"] = settings["seed"]
    if "imported" in settings:
        origin["imported"] = settings["imported"]
    return origin


def _trees(demos: Demos | StoredDemos) -> SearchTrees:
    nodes = demos.num_nodes if isinstance(demos, StoredDemos) else 0
    return {"search_trees": {"trees": len(demos), "nodes": nodes}} if nodes else {}


def _spread(x: np.ndarray) -> Spread:
    return {"min": float(x.min()), "median": float(np.median(x)), "max": float(x.max())}
