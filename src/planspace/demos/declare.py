"""What the states of a source mean: angles, quaternions, units, and columns to leave out.

The user declares it with options, or it is guessed from names and values if there is no model that says it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planspace.demos.episode import Episode
from planspace.demos.guess import CONVERSIONS, RADIANS, guess_quaternions, is_compass_angle
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.demos.survey import Survey
from planspace.errors import UsageError, unknown
from planspace.physics.angles import TWO_PI

ORDERS = {"wxyz": (0, 1, 2, 3), "xyzw": (3, 0, 1, 2)}
"""Positions of w, x, y, z in each order of the columns of a quaternion."""


@dataclass(frozen=True)
class Meaning:
    """What the states mean, and how those of the source become those of the dataset."""

    info: StateInfo
    """The states of the dataset."""
    columns: tuple[int, ...]
    """The column of the source that each state is in."""
    factors: tuple[float, ...]
    """By what each state is multiplied: to convert degrees to radians."""
    notes: tuple[str, ...]
    """Why each state has its meaning, if this was guessed or declared."""

    @property
    def changes_numbers(self) -> bool:
        """Whether `apply` changes anything."""
        return self.columns != tuple(range(len(self.columns))) or any(f != 1.0 for f in self.factors)

    @property
    def rotations(self) -> tuple[int, ...]:
        """Columns of the source that are angles on a circle or belong to quaternions."""
        quaternions = [first + k for first in self.info.quaternion_columns for k in range(4)]
        return tuple(self.columns[place] for place in (*self.info.circular_columns, *quaternions))

    def apply(self, episode: Episode) -> Episode:
        """A demonstration with the states of the dataset."""
        columns, factors = list(self.columns), np.array(self.factors)
        states, goal = episode.states[:, columns] * factors, episode.goal[columns] * factors
        return replace(episode, states=states, goal=goal)


def declare_states(
    info: StateInfo,
    survey: Survey,
    options: ImportOptions,
    columns: Sequence[str] = (),
    *,
    recorded_units: Mapping[str, str] | None = None,
    guess: bool = True,
) -> Meaning:
    """Decide what the states of a source mean.

    Args:
        info: what the format or the planning problem says.
        survey: statistics of the states.
        options: what the user declares.
        columns: names of all columns of a table, which options may name too.
        recorded_units: units of states by name that the source says. If `info` knows another unit, the
            numbers are converted to that.
        guess: whether to guess what neither of them says.

    Raises:
        UsageError: an option names a state that does not exist, or contradicts another.
    """
    names, units = info.names, list(info.units)
    _check_names(names, options, columns)
    free = guess and info.source is None and not info.problem  # a model says what its states are
    notes = [""] * len(names)
    factors = [1.0] * len(names)
    for name, unit in {**(recorded_units or {}), **options.units}.items():
        if name in names:
            column = names.index(name)
            factors[column] = _conversion(name, unit, units[column])
            notes[column] = "--unit" if name in options.units else ""
            if factors[column] != 1.0:
                notes[column] = f"converted from {unit}"
            units[column] = units[column] or unit
    quaternions = {**_known(info), **_declared_quaternions(info, options)}
    if free:
        quaternions = {**_guessed_quaternions(names, survey, quaternions, options), **quaternions}
    _check_length(info, survey, quaternions)
    in_quaternion = {column for columns in quaternions for column in columns}
    circles: dict[int, str] = dict.fromkeys(info.circular_columns, "")
    for column, name in enumerate(names):
        if name in options.circular:
            circles[column] = "--circular"
        elif name in options.linear:
            circles.pop(column, None)
        elif free and column not in (*circles, *in_quaternion):
            note, unit = _guess_circle(name, units[column], column, survey)
            if note:
                circles[column], units[column] = note, unit
    return _arrange(info, units, factors, circles, quaternions, notes, options)


def _conversion(name: str, unit: str, known: str) -> float:
    """By what a number in `unit` is multiplied to have the unit `known`; 1 if that is empty."""
    if not known or unit == known:
        return 1.0
    factors = CONVERSIONS.get(known, {known: 1.0})
    if unit not in factors:
        raise UsageError(
            f"{name!r} is in {known}; {unit!r} cannot be converted to it, only {', '.join(factors)}."
        )
    return factors[unit]


def _check_names(names: Sequence[str], options: ImportOptions, others: Sequence[str]) -> None:
    """Check that the states that options name exist, and that no state is declared twice."""
    every = list(dict.fromkeys([*names, *others]))
    given = {
        "circular": (options.circular, names),
        "linear": (options.linear, names),
        "unit": (options.units, every),
        "drop": (options.drop, every),
        "keep": (options.keep, every),
    }
    for option, (wanted, known) in given.items():
        if wrong := next((name for name in wanted if name not in known), None):
            raise UsageError(f"--{option}: {unknown('state', wrong, known)}")
    if both := [name for name in options.circular if name in options.linear]:
        raise UsageError(f"--circular and --linear both name {both[0]!r}; give one of them.")


Quaternions = dict[tuple[int, int, int, int], str]
"""Columns of w, x, y, z of each quaternion, and why it is one."""


def _known(info: StateInfo) -> Quaternions:
    return {(c, c + 1, c + 2, c + 3): "" for c in info.quaternion_columns}


def _declared_quaternions(info: StateInfo, options: ImportOptions) -> Quaternions:
    found: Quaternions = {}
    for text in options.quaternions:
        first, *rest = text.split(":")
        order = rest.pop() if len(rest) == 2 else "wxyz"
        if len(rest) != 1 or order not in ORDERS:
            raise UsageError(f"--quaternion needs FIRST:LAST or FIRST:LAST:xyzw, got {text!r}.")
        for name in (first, rest[0]):
            if name not in info.names:
                raise UsageError(f"--quaternion: {unknown('state', name, info.names)}")
        start, stop = info.names.index(first), info.names.index(rest[0])
        if stop - start != 3:
            raise UsageError(
                f"--quaternion {text}: a quaternion is four neighbouring states, but {first!r} is state "
                f"{start} and {rest[0]!r} is state {stop}."
            )
        w, x, y, z = (start + k for k in ORDERS[order])
        found[w, x, y, z] = f"--quaternion, order {order}"
    return found


def _check_length(info: StateInfo, survey: Survey, quaternions: Quaternions) -> None:
    for columns, note in quaternions.items():
        if note.startswith("--") and not survey.has_unit_length(min(columns)):
            low, high = survey.lengths(min(columns))
            raise UsageError(
                f"--quaternion: {info.names[min(columns)]} to {info.names[max(columns)]} are not unit "
                f"quaternions: their length is between {low:.4g} and {high:.4g}. A length of 0 often means "
                "that a tracker lost the body; leave such rows out."
            )


def _guessed_quaternions(
    names: Sequence[str], survey: Survey, known: Quaternions, options: ImportOptions
) -> Quaternions:
    taken = {column for columns in known for column in columns}
    taken |= {
        i for i, name in enumerate(names) if name in (*options.drop, *options.linear, *options.circular)
    }
    return {
        columns: "guessed from names and length 1"
        for columns in guess_quaternions(names)
        if not taken & set(columns) and survey.has_unit_length(min(columns))
    }


def _guess_circle(name: str, unit: str, column: int, survey: Survey) -> tuple[str, str]:
    """Why a state is an angle on a circle, and its unit; empty texts if it is none."""
    if wraps := survey.wraps(column, unit):
        turn = "2 pi" if wraps == "rad" else "360"
        return f"guessed: it jumps by {turn}", wraps
    if is_compass_angle(name) and (unit in RADIANS or (not unit and survey.reach(column) <= TWO_PI)):
        return "guessed from its name", unit or "rad"
    return "", unit


def _arrange(
    info: StateInfo,
    units: list[str],
    factors: list[float],
    circles: dict[int, str],
    quaternions: Quaternions,
    notes: list[str],
    options: ImportOptions,
) -> Meaning:
    """Put the numbers of each quaternion next to each other, in the order w, x, y, z."""
    kept = [i for i, name in enumerate(info.names) if name not in options.drop]
    whole = {columns: note for columns, note in quaternions.items() if set(columns) <= set(kept)}
    members = {column: columns for columns in whole for column in columns}
    columns = list(dict.fromkeys(c for column in kept for c in members.get(column, (column,))))
    for quaternion, note in whole.items():
        for column in quaternion:
            notes[column] = note
    for column, note in circles.items():
        notes[column] = note or notes[column]
        unit = units[column] or "rad"
        if unit not in RADIANS:
            raise UsageError(
                f"{info.names[column]!r} has the unit {unit!r}, which is not that of an angle; give --unit "
                f"{info.names[column]}=rad or deg, or --linear {info.names[column]}."
            )
        if RADIANS[unit] != 1.0:
            factors[column], notes[column] = RADIANS[unit], f"{notes[column]}; converted from {unit}"
        units[column] = "rad" if note or units[column] else ""
    same = columns == list(range(len(info.names)))
    chosen = info if same else info.choose(tuple(info.names[c] for c in columns), columns)
    return Meaning(
        info=replace(
            chosen,
            units=tuple(units[c] for c in columns),
            circular_columns=tuple(i for i, c in enumerate(columns) if c in circles),
            quaternion_columns=tuple(columns.index(quaternion[0]) for quaternion in whole),
        ),
        columns=tuple(columns),
        factors=tuple(factors[c] for c in columns),
        notes=tuple(notes[c] for c in columns),
    )
