"""Choose the columns of a table that contain the time, the states and the controls."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, unknown

TIME_NAMES = ("time", "t")
EPISODE_NAME = "episode"
MAX_COLUMNS = 10_000
"""A table with more columns is rejected; no robot has this many joints."""
NO_CONTROLS = "the source has no controls: zeros are stored instead."


@dataclass(frozen=True)
class Columns:
    """The columns of a table by their content."""

    info: StateInfo
    """The states of the planning problem, or states named as their columns."""
    time: int | None
    """Column of the time; None if there is no such column."""
    states: tuple[int, ...]
    """Column of each state."""
    controls: tuple[int, ...]
    """Column of each control; empty if the table has no controls."""
    episode: int | None
    """Column with the number of the demonstration; None if there is no such column."""


def choose_columns(
    header: Sequence[str], info: StateInfo | None, options: ImportOptions, where: str
) -> Columns:
    """Choose columns by name.

    Args:
        header: the names of the columns.
        info: the states of the planning problem. Each is in the column that `options.states` gives, or in the
            column with its own name. If None, the states are those in `options.states`, or all columns
            except time, episode and controls.
        options: the columns that the user named.
        where: the file, for messages.

    Raises:
        UsageError: an option names a state or control that the problem does not have.
        PlanspaceError: a column is missing (the message suggests a similar name) or duplicated, or there are
            too many columns.
    """
    if len(header) > MAX_COLUMNS:
        raise PlanspaceError(f"{where} has {len(header)} columns; at most {MAX_COLUMNS} are allowed.")
    twice = sorted(name for name, count in Counter(header).items() if count > 1)
    if twice:
        raise PlanspaceError(f"{where} has two columns named {twice[0]!r}; rename one of them.")
    taken = set(options.states.values()) | (set(info.names) if info else set())
    free = [name for name in header if name not in taken]
    time = next((name for name in TIME_NAMES if name in free), None)
    controls = _control_columns(free, info, options)
    if info is not None:
        for name in options.states:
            if name not in info.names:
                raise unknown("state", name, info.names)
        states = [options.states.get(name, name) for name in info.names]
    else:
        used = {time, EPISODE_NAME, *controls}
        states = list(options.states.values()) or [name for name in free if name not in used]
        names = tuple(options.states) or tuple(states)
        info = StateInfo(names, ("",) * len(names), (), len(controls))
    if not states:
        raise PlanspaceError(f"{where} has no column with a state; its columns are {', '.join(header)}.")
    position = {name: i for i, name in enumerate(header)}
    for name in (*states, *controls):
        if name not in position:
            raise PlanspaceError(f"{where}: {unknown('column', name, header)}")
    return Columns(
        info=info,
        time=None if time is None else position[time],
        states=tuple(position[name] for name in states),
        controls=tuple(position[name] for name in controls),
        episode=position[EPISODE_NAME] if EPISODE_NAME in free else None,
    )


def _control_columns(free: Sequence[str], info: StateInfo | None, options: ImportOptions) -> list[str]:
    """The columns of the controls in order; empty if the table has none of them."""
    if info is None:
        return list(options.controls.values()) or _numbered(free)
    actuators = _actuators(info)
    from_1 = [f"control{i + 1}" for i in range(info.num_controls)]
    from_0 = [f"control{i}" for i in range(info.num_controls)]
    for name in options.controls:
        if name not in (*from_1, *actuators):
            raise unknown("control", name, (*from_1, *actuators))
    conventions = [from_0, from_1] if "control0" in free else [from_1, actuators]
    defaults = next((c for c in conventions if set(c) & set(free)), [])
    if not (defaults or options.controls):
        return []
    defaults = defaults or from_1
    return [
        options.controls.get(a) or options.controls.get(b) or default
        for a, b, default in zip(from_1, actuators or from_1, defaults, strict=True)
    ]


def _numbered(free: Sequence[str]) -> list[str]:
    """The columns named control0, control1, ... or control1, control2, ... that exist."""
    numbers = sorted(int(m[1]) for m in (re.fullmatch(r"control(\d{1,4})", name) for name in free) if m)
    return [f"control{i}" for i in numbers]


def _actuators(info: StateInfo) -> list[str]:
    """The names of the actuators; empty if there is no model or if controls are not actuators."""
    if info.source is None or info.kinematic:  # the controls of a kinematic model are joint velocities
        return []
    model, _ = info.compile()
    names = [model.actuator(i).name or f"control{i + 1}" for i in range(model.nu)]
    return names if len(names) == info.num_controls else []
