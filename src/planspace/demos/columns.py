"""Which columns of a table hold the time, the states and the controls."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from planspace.demos.dataset import StateInfo
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError, unknown

TIME_NAMES = ("time", "t")
EPISODE_NAME = "episode"
MAX_COLUMNS = 10_000
"""No robot has so many joints."""
NO_CONTROLS = "the source has no controls: zeros are stored in their place."


@dataclass(frozen=True)
class Columns:
    """Where a table has what."""

    info: StateInfo
    """What the states are: the problem's, or the columns' own names."""
    time: int | None
    states: tuple[int, ...]
    controls: tuple[int, ...]
    """Empty where the table has none; `info.num_controls` says how many there should be."""
    episode: int | None
    """Which column numbers the demonstrations."""


def choose_columns(
    header: Sequence[str], info: StateInfo | None, options: ImportOptions, where: str
) -> Columns:
    """Chooses columns by name.

    Args:
        header: the columns' names.
        info: the problem's states, if there is a problem: each is looked for under its own name, or the
            one `options.states` gives. Without it the states are those of `options.states`, or all columns
            that are not time, episode or controls.
        options: the columns the caller named.
        where: the file, for messages.

    Raises:
        UsageError: an option names a state or control that the problem does not have.
        PlanspaceError: a column is missing or comes twice (the nearest name is suggested), or there are too
            many.
    """
    if len(header) > MAX_COLUMNS:
        raise PlanspaceError(f"{where} has {len(header)} columns; {MAX_COLUMNS} may be.")
    twice = sorted(name for name, count in Counter(header).items() if count > 1)
    if twice:
        raise PlanspaceError(f"{where} has two columns {twice[0]!r}; each needs a name of its own.")
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
        spoken_for = {time, EPISODE_NAME, *controls}
        states = list(options.states.values()) or [name for name in free if name not in spoken_for]
        names = tuple(options.states) or tuple(states)
        info = StateInfo(names, ("",) * len(names), (), len(controls))
    if not states:
        raise PlanspaceError(f"{where} has no column left for a state; it has {', '.join(header)}.")
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
    """The columns of the controls in order; empty if there are none, or all of them are missing."""
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
    """The columns control0, control1 ... or control1, control2 ... that are there."""
    numbers = sorted(int(m[1]) for m in (re.fullmatch(r"control(\d{1,4})", name) for name in free) if m)
    return [f"control{i}" for i in numbers]


def _actuators(info: StateInfo) -> list[str]:
    """The names of the model's actuators, where there is a model whose actuators are the controls."""
    if not info.mjcf or info.kinematic:  # controls are joint velocities then
        return []
    model, _ = info.compile()
    names = [model.actuator(i).name or f"control{i + 1}" for i in range(model.nu)]
    return names if len(names) == info.num_controls else []
