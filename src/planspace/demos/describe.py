"""What a dataset holds, and whether it is what it says it is."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.folder import MINARI_PREFIX, StoredDemos, load_demos
from planspace.errors import PlanspaceError
from planspace.mjcf.subprocess_model import check_compiles
from planspace.physics.replay import replay
from planspace.progress import progress_over

REPLAY_TOLERANCE = 1e-6
"""Largest difference of a replayed state [m, rad, m/s, rad/s] on the MuJoCo that recorded it."""
LARGEST_NUMBER = 1e10
"""MuJoCo takes a state beyond for one that ran away (its mjMAXVAL)."""


def describe(folder: Path) -> dict[str, Any]:
    """Counts, sizes and durations of a dataset."""
    demos = _opened(folder)
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
        "states_a_demonstration": _spread(lengths),
        "duration_s": _spread(durations),
        "hash": demos.hash,
    }


def validate(folder: Path, *, replay_controls: bool, untrusted: bool = False) -> dict[str, Any]:
    """Verifies hashes, numbers that a robot can have, rising times, and on request that the controls replay.

    Args:
        folder: the dataset's.
        replay_controls: whether to replay them in its model.
        untrusted: whether to try the model first in a process of its own.

    Raises:
        PlanspaceError: something does not hold; the shard or demonstration is named.
    """
    demos = _opened(folder)
    if replay_controls and untrusted:
        check_compiles(demos.info.mjcf)
    worst = 0.0
    for first, part in progress_over(_parts(demos), "validate", unit="shard"):
        _check_numbers(part, first, folder)
        _check_times(part, first, folder)
        if replay_controls:
            worst = max(worst, _check_replay(part, first, folder))
    found: dict[str, Any] = {"demonstrations": len(demos), "hash": demos.hash}
    return found | ({"replay_error": worst} if replay_controls else {})


def _check_numbers(part: Demos, first: int, folder: Path) -> None:
    for i in range(len(part)):
        e = part.episode(i)
        numbers = {"state": e.states, "control": e.controls, "goal": e.goal, "cost": np.array([e.cost])}
        for name, values in numbers.items():
            large = values[np.abs(values) > LARGEST_NUMBER]  # not NaN: of a goal or a cost nothing is known
            if len(large):
                raise PlanspaceError(
                    f"{folder}: demonstration {first + i} holds a {name} with the number {large[0]:.3g}; no "
                    f"robot's is beyond {LARGEST_NUMBER:.0e}."
                )


def _check_times(part: Demos, first: int, folder: Path) -> None:
    for i in range(len(part)):
        if (np.diff(part.episode(i).times) <= 0).any():
            raise PlanspaceError(f"{folder}: the times of demonstration {first + i} do not rise.")


def _check_replay(part: Demos, first: int, folder: Path) -> float:
    errors = replay_errors(part)
    if not errors.max() <= REPLAY_TOLERANCE:  # it may be no number, where physics run away
        raise PlanspaceError(
            f"{folder}: replaying the controls of demonstration {first + int(errors.argmax())} misses its "
            f"states by up to {errors.max():.2g}; another MuJoCo recorded it, or it is no record of this "
            "model."
        )
    return float(errors.max())


def replay_errors(demos: Demos) -> np.ndarray:
    """The largest difference between recorded and replayed states of each demonstration.

    Raises:
        PlanspaceError: the dataset has no model.
    """
    model, space = demos.info.compile()
    errors = []
    for i in range(len(demos)):
        e = demos.episode(i)
        states = replay(model, space, e.states[0], e.controls, e.times)
        errors.append(np.abs(states - e.states).max())
    return np.array(errors)


def _opened(folder: Path) -> Demos | StoredDemos:
    return load_demos(folder) if str(folder).startswith(MINARI_PREFIX) else StoredDemos(folder)


def _parts(demos: Demos | StoredDemos) -> Iterator[tuple[int, Demos]]:
    """The number of its first demonstration, and a shard; one in memory at a time."""
    first = 0
    for part in [demos] if isinstance(demos, Demos) else demos.shards():
        yield first, part
        first += len(part)


def _origin(demos: Demos | StoredDemos, folder: Path) -> dict[str, Any]:
    """What planned the demonstrations, or where they were imported from."""
    if isinstance(demos, Demos):
        return {"imported": str(folder)}
    return {key: demos.settings[key] for key in ("planner", "seed", "imported") if key in demos.settings}


def _spread(x: np.ndarray) -> dict[str, float]:
    return {"least": float(x.min()), "median": float(np.median(x)), "most": float(x.max())}
