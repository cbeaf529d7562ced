"""What a dataset holds, and whether it is what it says it is."""

from pathlib import Path
from typing import Any

import numpy as np

from planspace.demos.dataset import MANIFEST, MINARI_PREFIX, Demos, load_demos
from planspace.errors import PlanspaceError
from planspace.physics.apart import compile_apart
from planspace.physics.simulate import replay
from planspace.store import read_sealed

REPLAY_TOLERANCE = 1e-6
"""Largest difference of a replayed state [m, rad, m/s, rad/s] on the MuJoCo that recorded it."""


def describe(folder: Path) -> dict[str, Any]:
    """Counts, sizes and durations of a dataset."""
    demos = load_demos(folder)
    lengths, durations = np.diff(demos.offsets), demos.times[demos.offsets[1:] - 1]
    return {
        "demonstrations": len(demos),
        "states": len(demos.states),
        "reached_goal": int(demos.success.sum()),
        "state": dict(zip(demos.info.names, demos.info.units, strict=True)),
        "circular": [demos.info.names[c] for c in demos.info.circular_columns],
        "controls": demos.info.num_controls,
        "problem": demos.info.problem,
        "made_by": _origin(folder),
        "states_a_demonstration": _spread(lengths),
        "duration_s": _spread(durations),
        "hash": demos.hash,
    }


def validate(folder: Path, *, replay_controls: bool, untrusted: bool = False) -> dict[str, Any]:
    """Verifies hashes, finite numbers, rising times, and on request that the controls replay.

    Args:
        folder: the dataset's.
        replay_controls: whether to replay them in its model.
        untrusted: whether to try the model first in a process of its own.

    Raises:
        PlanspaceError: something does not hold; the shard or demonstration is named.
    """
    demos = load_demos(folder)
    if not (np.isfinite(demos.states).all() and np.isfinite(demos.controls).all()):
        raise PlanspaceError(f"{folder} holds a number that is not finite.")
    for i in range(len(demos)):
        if (np.diff(demos.episode(i).times) <= 0).any():
            raise PlanspaceError(f"{folder}: the times of demonstration {i} do not rise.")
    found: dict[str, Any] = {"demonstrations": len(demos), "hash": demos.hash}
    if replay_controls:
        if untrusted:
            compile_apart(demos.info.mjcf)
        errors = replay_errors(demos)
        if not errors.max() <= REPLAY_TOLERANCE:  # it may be no number, where physics run away
            raise PlanspaceError(
                f"{folder}: replaying the controls of demonstration {int(errors.argmax())} misses its states "
                f"by up to {errors.max():.2g}; another MuJoCo recorded it, or it is no record of this model."
            )
        found["replay_error"] = float(errors.max())
    return found


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


def _origin(folder: Path) -> dict[str, Any]:
    """What planned the demonstrations, or where they were imported from."""
    if str(folder).startswith(MINARI_PREFIX):
        return {"imported": str(folder)}
    settings = read_sealed(folder / MANIFEST)["settings"]
    return {key: settings[key] for key in ("planner", "seed", "imported") if key in settings}


def _spread(x: np.ndarray) -> dict[str, float]:
    return {"least": float(x.min()), "median": float(np.median(x)), "most": float(x.max())}
