"""Choose the columns of a table that contain the time, the demonstration, the states and the controls."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from planspace.demos.formats.format import Column, Kind
from planspace.demos.guess import guess_kind, guess_unit, is_counter
from planspace.demos.recording import ImportOptions, Use
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, unknown

TIME_NAMES = ("time", "t")
EPISODE_NAME = "episode"
MAX_COLUMNS = 10_000
"""A table with more columns is rejected; no robot has this many joints."""
NO_CONTROLS = "the source has no controls: zeros are stored instead."

Roles = dict[str, tuple[Kind, int]]
"""What each used column contains, and the number of the state or control in it."""


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
    split: int | None = None
    """Column with the name of the split; None if the user names no such column."""
    state_units: Mapping[str, str] = field(default_factory=dict)
    """Units of states by name, as the table says."""
    time_unit: str = ""
    """Unit of the time; empty if it is unknown."""
    restarts: bool = False
    """Whether a demonstration begins where the column `episode` goes back, instead of where it changes."""
    uses: tuple[Use, ...] = ()
    """What every column of the table is used for."""


def choose_columns(
    columns: Sequence[Column], info: StateInfo | None, options: ImportOptions, where: str
) -> Columns:
    """Choose columns by name. A column of times or a counter is a state only if the user names it.

    Args:
        columns: the columns of the table.
        info: the states of the planning problem. Each is in the column that `options.states` gives, or in the
            column with its own name. If None, the states are those in `options.states`, or all columns
            except time, episode, controls, and those whose names say that they count rows.
        options: the columns that the user named.
        where: the file, for messages.

    Raises:
        UsageError: an option names a state or control that the problem does not have.
        PlanspaceError: a column is missing (the message suggests a similar name) or duplicated, or there are
            too many columns.
    """
    options = _by_number(columns, options)
    names = _check_names(columns, options, where)
    position = {name: i for i, name in enumerate(names)}
    units = {c.name: options.units.get(c.name) or guess_unit(c).unit for c in columns}
    taken = {*options.states.values(), *options.controls.values(), *(info.names if info else ())}
    free = [column for column in columns if column.name not in {*taken, *options.drop, options.split}]
    kinds: dict[str, Kind | None] = {c.name: c.kind or guess_kind(c) for c in free}
    kinds |= dict.fromkeys(options.keep, "state")
    time = "" if options.dt is not None else options.time or _first(kinds, "time", TIME_NAMES)
    episode = options.episode or _first(kinds, "episode", (EPISODE_NAME,))
    left = [name for name in kinds if name not in (time, episode)]
    controls = _control_columns(left, kinds, info, options)
    if info is None:
        info, states = _named_states(left, kinds, units, controls, options)
    else:
        if wrong := next((name for name in options.states if name not in info.names), None):
            raise unknown("state", wrong, info.names)
        states = [options.states.get(name, name) for name in info.names]
    if not states:
        raise PlanspaceError(
            f"{where} has no column with a state; its columns are {', '.join(names)}. --keep NAME makes a "
            "column a state."
        )
    for name in (*states, *controls):
        if name not in position:
            raise PlanspaceError(f"{where}: {unknown('column', name, names)}")
    roles: Roles = {time: ("time", -1), episode: ("episode", -1), options.split: ("split", -1)}
    roles |= {name: ("control", i) for i, name in enumerate(controls)}
    roles |= {name: ("state", i) for i, name in enumerate(states)}
    return Columns(
        info=info,
        time=position[time] if time else None,
        states=tuple(position[name] for name in states),
        controls=tuple(position[name] for name in controls),
        episode=position[episode] if episode else None,
        split=position.get(options.split),
        state_units={
            state: units[column] for state, column in zip(info.names, states, strict=True) if units[column]
        },
        time_unit=units.get(time, ""),
        restarts=bool(episode) and (episode == time or kinds.get(episode) == "time" or is_counter(episode)),
        uses=tuple(
            _use(column, units[column.name], roles, kinds.get(column.name), options) for column in columns
        ),
    )


def _by_number(columns: Sequence[Column], options: ImportOptions) -> ImportOptions:
    """The options with the names of columns instead of their numbers, counted from 0."""
    names = [column.name for column in columns]

    def name(text: str) -> str:
        is_number = text.isascii() and text.isdigit() and text not in names
        return names[int(text)] if is_number and int(text[:9]) < len(names) else text

    return replace(
        options,
        states={state: name(column) for state, column in options.states.items()},
        controls={control: name(column) for control, column in options.controls.items()},
        time=name(options.time),
        episode=name(options.episode),
    )


def _named_states(
    free: Sequence[str],
    kinds: Mapping[str, Kind | None],
    units: Mapping[str, str],
    controls: Sequence[str],
    options: ImportOptions,
) -> tuple[StateInfo, list[str]]:
    """States named as the user wants or as their columns, and their columns."""
    columns = list(options.states.values()) or [
        name for name in free if name not in controls and kinds[name] in (None, "state")
    ]
    names = tuple(options.states) or tuple(columns)
    pairs = zip(names, columns, strict=True)
    state_units = tuple(options.units.get(name) or units.get(column, "") for name, column in pairs)
    return StateInfo(names, state_units, (), len(controls)), columns


def _check_names(columns: Sequence[Column], options: ImportOptions, where: str) -> list[str]:
    """The names of the columns; each exists once, and so do those that the user named."""
    names = [column.name for column in columns]
    if len(names) > MAX_COLUMNS:
        raise PlanspaceError(f"{where} has {len(names)} columns; at most {MAX_COLUMNS} are allowed.")
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise PlanspaceError(f"{where} has two columns named {twice[0]!r}; rename one of them.")
    given = {"time": [options.time], "episode": [options.episode], "drop": options.drop, "keep": options.keep}
    for option, wanted in given.items():
        for name in wanted:
            if name and name not in names:
                raise PlanspaceError(f"{where}, --{option}: {unknown('column', name, names)}")
    return names


def _first(kinds: Mapping[str, Kind | None], kind: Kind, preferred: Sequence[str]) -> str:
    """The column of a kind: one with a preferred name, otherwise the first; empty if there is none."""
    found = [name for name, its in kinds.items() if its == kind]
    return next((name for name in preferred if name in found), found[0] if found else "")


def _control_columns(
    free: Sequence[str], kinds: Mapping[str, Kind | None], info: StateInfo | None, options: ImportOptions
) -> list[str]:
    """The columns of the controls in order; empty if the table has none of them."""
    if info is None:
        found = [name for name in free if kinds[name] == "control"]
        return list(options.controls.values()) or sorted(found, key=_number)
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


def _number(name: str) -> tuple[str, int]:
    """Sort key that puts `control2` before `control10`."""
    match = re.search(r"(\d+)\D*$", name)
    return (name[: match.start()], int(match[1])) if match else (name, -1)


def _actuators(info: StateInfo) -> list[str]:
    """The names of the actuators; empty if there is no model or if controls are not actuators."""
    if info.source is None or info.kinematic:  # the controls of a kinematic model are joint velocities
        return []
    model, _ = info.compile()
    names = [model.actuator(i).name or f"control{i + 1}" for i in range(model.nu)]
    return names if len(names) == info.num_controls else []


def _use(column: Column, unit: str, roles: Roles, kind: Kind | None, options: ImportOptions) -> Use:
    """What a column is used for, and why."""
    name = column.name
    role, index = roles.get(name, ("unused", -1))
    given = name in (options.time, options.episode, *options.keep, *options.controls.values())
    note = "guessed from its name" if role == kind and not (given or column.kind) else ""
    if role == "unused":
        note = "--drop" if name in options.drop else _why_unused(name, kind, options)
    return Use(name, role, unit or ("s" if role == "time" else ""), note, index)


def _why_unused(name: str, kind: Kind | None, options: ImportOptions) -> str:
    reasons: dict[Kind | None, str] = {
        "time": "--dt is used instead" if options.dt is not None else "a second time",
        "episode": "a second number of the demonstration",
        "unused": "guessed: a counter or an outcome",
    }
    return f"{reasons[kind]}; --keep {name} makes it a state" if kind in reasons else "not chosen"
