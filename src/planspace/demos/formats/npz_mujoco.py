"""NPZ archives with the states of MuJoCo or dm_control.

    qpos [T, nq], qvel [T, nv], act [T, na]   positions, velocities and, if the model has any, activations
    physics or state [T, nq + nv + na]        the same in one array, as dm_control's Physics.get_state()
    state [T, 1 + nq + nv + na]               with the time first, as MuJoCo's mjSTATE_FULLPHYSICS

A model says what the numbers mean; without one, only `qpos` and `qvel` can be told apart.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from planspace.demos.episode import Episode
from planspace.demos.formats.columns import NO_CONTROLS
from planspace.demos.formats.npz_arrays import ACTIVATIONS, CONTROLS, POSITIONS, TIMES, VELOCITIES, ArrayFile
from planspace.demos.recording import Imported, ImportOptions, check_rising, recorded
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from planspace.physics.space import StateSpace

WHOLE = ("physics", "state", "states")
"""Names of arrays with positions, velocities and activations."""


class _Layout(NamedTuple):
    """Which arrays of an archive are read."""

    states: tuple[str, ...]
    time: str
    """Empty if no array has the time."""
    control: str
    """Empty if no array has controls."""

    @property
    def keys(self) -> list[str]:
        """All arrays."""
        return [*self.states, *([self.time] if self.time else []), *([self.control] if self.control else [])]


class _Model(NamedTuple):
    """The model of the states."""

    model: mujoco.MjModel
    space: StateSpace

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of positions, velocities and activations."""
        return self.model.nq, self.model.nv, self.model.na


def has_mujoco_states(files: Sequence[ArrayFile], info: StateInfo | None) -> bool:
    """Whether archives have states of MuJoCo that `read_mujoco_states` can read.

    Args:
        files: at least one archive.
        info: the states of the planning problem or model; None if there is neither.
    """
    model = _compile(info)
    return all(_state_keys(file, model) for file in files)


def read_mujoco_states(
    files: Sequence[ArrayFile], info: StateInfo | None, options: ImportOptions
) -> Imported:
    """Read the states of MuJoCo.

    Args:
        files: at least one archive.
        info: the states of the planning problem or model. If None, they are named `qpos0`, ..., `qvel0`, ...
        options: `dt` is the time between states [s], if the archives do not have times.

    Raises:
        UsageError: the archives have no times, and `dt` is missing.
        PlanspaceError: the archives differ, an array does not fit the model, or times do not increase.
    """
    model = _compile(info)
    layouts = [_layout(file, model, options) for file in files]
    own = [_info(file, layout, info, model) for file, layout in zip(files, layouts, strict=True)]
    for file, found in zip(files, own, strict=True):
        if found != own[0]:
            raise PlanspaceError(
                f"{file.path} has {len(found.names)} numbers per state and {found.num_controls} per control, "
                f"but {files[0].path} has {len(own[0].names)} and {own[0].num_controls}; import each on its "
                "own."
            )
    notices = dict.fromkeys(notice for file in files for notice in file.notices)
    has_controls = all(layout.control for layout in layouts)
    if options.dt and (
        unused := next((key for key in TIMES for file in files if file.sizes.get(key) == 1), "")
    ):
        notices[f"--dt is used instead of the times in {unused!r}"] = None
    episodes = _episodes(files, layouts, own[0], model, options)
    return Imported(own[0], episodes, (*notices, *(() if has_controls else (NO_CONTROLS,))))


def _compile(info: StateInfo | None) -> _Model | None:
    return None if info is None or info.source is None else _Model(*info.compile())


def _state_keys(file: ArrayFile, model: _Model | None) -> tuple[str, ...]:
    """The arrays that have the states; empty if there are none."""
    if POSITIONS in file.sizes and VELOCITIES in file.sizes:
        return tuple(key for key in (POSITIONS, VELOCITIES, ACTIVATIONS) if file.sizes.get(key))
    if model is not None:
        size = sum(model.sizes)
        return tuple(key for key in WHOLE if file.sizes.get(key) in (size, size + 1))[:1]
    return ()


def _layout(file: ArrayFile, model: _Model | None, options: ImportOptions) -> _Layout:
    states = _state_keys(file, model)
    time = next((key for key in TIMES if file.sizes.get(key) == 1), "")
    control = next((key for key in CONTROLS if file.sizes.get(key)), "")
    has_time = model is not None and file.sizes[states[0]] == sum(model.sizes) + 1
    if not (time or has_time or options.dt):
        raise UsageError(
            f"{file.path} has no array with the time of each state ({', '.join(TIMES)}); give --dt SECONDS, "
            "the time between states: the model's time step times the number of steps between them."
        )
    return _Layout(states, "" if options.dt else time, control)


def _info(file: ArrayFile, layout: _Layout, info: StateInfo | None, model: _Model | None) -> StateInfo:
    """The meaning of the states; the number of controls is that of the archive."""
    num_controls = file.sizes[layout.control] if layout.control else 0
    if model is None:
        names = tuple(f"{key}{i}" for key in layout.states for i in range(file.sizes[key]))
        if info is None:
            return StateInfo(names, ("",) * len(names), (), num_controls)
        if len(info.names) != len(names):
            raise PlanspaceError(
                f"{file.path} has {len(names)} numbers per state ({', '.join(layout.states)}), but a state "
                f"of {info.problem!r} has {len(info.names)} ({', '.join(info.names)})."
            )
        return info
    assert info is not None
    if layout.states[0] == POSITIONS:
        _check_sizes(file, model)
    if info.problem and layout.control and num_controls != info.num_controls:
        raise PlanspaceError(
            f"{file.path}: {layout.control!r} has {num_controls} numbers, but {info.problem!r} has "
            f"{info.num_controls} controls. To import the actions of another controller, give --model "
            "instead of --problem."
        )
    return replace(info, num_controls=num_controls) if layout.control else info


def _check_sizes(file: ArrayFile, model: _Model) -> None:
    wanted = dict(zip((POSITIONS, VELOCITIES, ACTIVATIONS), model.sizes, strict=True))
    if not model.space.num_activations:  # the state has none
        del wanted[ACTIVATIONS]
    for key, size in wanted.items():
        if file.sizes.get(key, 0) != size:
            raise PlanspaceError(
                f"{file.path}: {key!r} has {file.sizes.get(key, 0)} numbers, but the model has {size}; give "
                "the model that the states were recorded from."
            )


# --- one demonstration ------------------------------------------------------------------------------


def _episodes(
    files: Sequence[ArrayFile],
    layouts: Sequence[_Layout],
    info: StateInfo,
    model: _Model | None,
    options: ImportOptions,
) -> Iterator[Episode]:
    index = 0
    for file, layout in zip(files, layouts, strict=True):
        for i, arrays in enumerate(file.demonstrations(layout.keys)):
            where = f"{file.path}, demonstration {i}" if len(file.lengths) > 1 else str(file.path)
            yield _episode(arrays, layout, info, model, options.dt, index, where)
            index += 1


def _episode(
    arrays: Mapping[str, np.ndarray],
    layout: _Layout,
    info: StateInfo,
    model: _Model | None,
    dt: float | None,
    index: int,
    where: str,
) -> Episode:
    rows = np.concatenate([arrays[key] for key in layout.states], axis=1)
    times = arrays[layout.time][:, 0] if layout.time else np.arange(len(rows)) * (dt or 0.0)
    if model is not None:
        if rows.shape[1] == sum(model.sizes) + 1 and layout.states[0] != POSITIONS:
            times, rows = (times if layout.time or dt else rows[:, 0]), rows[:, 1:]
        rows = rows[:, _columns(model)]
    check_rising(times, lambda i: f"{where}, row {i}")
    controls = arrays[layout.control] if layout.control else np.zeros((len(rows), info.num_controls))
    return recorded(rows, controls[:-1], times, index)


def _columns(model: _Model) -> list[int]:
    """The columns of positions, velocities and activations of a model that form its state."""
    nq, nv, na = model.sizes
    space = model.space
    velocities = [] if space.kinematic else [nq + k for k in space.qvel_index]
    return [*space.qpos_index, *velocities, *range(nq + nv, nq + nv + min(na, space.num_activations))]
