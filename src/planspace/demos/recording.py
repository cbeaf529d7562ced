"""What all readers of demonstrations share: their options, their result, and checks."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError

OptionName = Literal["state", "control", "dt", "filter-key", "time", "episode"]
Gaps = Literal["refuse", "split", "fill"]
"""What to do with a demonstration that lacks rows: refuse the source, cut it in two, or interpolate."""


@dataclass(frozen=True)
class ImportOptions:
    """How to read a source."""

    states: dict[str, str] = field(default_factory=dict)
    """For each state, the column (or the position in an observation) that contains it."""
    controls: dict[str, str] = field(default_factory=dict)
    """For each control (`control1` ..., or the name of an actuator), the column that contains it."""
    dt: float | None = None
    """Time between states [s], for a source that does not record times."""
    as_recorded: bool = False
    """Keep uneven time steps and angles with full turns; the study of the 2020 data needs both."""

    filter_key: str = ""
    """Name of a list of demonstrations in the file; only these are read. Empty for all."""
    untrusted: bool = False
    """Read HDF5 and Parquet files, and the models in them, in a subprocess with limited memory and time."""

    time: str = ""
    """Column with the time of each row; empty to find it by its name."""
    episode: str = ""
    """Column that numbers or names the demonstrations; empty to find it by its name. If it is the column of
    the times or a counter of rows, a demonstration begins where it goes back."""
    circular: Sequence[str] = ()
    """States that are angles on a circle."""
    linear: Sequence[str] = ()
    """States that are not angles on a circle, whatever their names and values suggest."""
    quaternions: Sequence[str] = ()
    """Four neighbouring states each, as `FIRST:LAST` (w, x, y, z) or `FIRST:LAST:xyzw`."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of columns by name."""
    drop: Sequence[str] = ()
    """Columns to leave out."""
    keep: Sequence[str] = ()
    """Columns that are states, although their names suggest a time, a counter or an outcome."""
    split: str = ""
    """A JSON file with the demonstrations of each split, a column with the name of the split, or `source` for
    the splits that the source names; see `planspace.demos.splits`."""
    rate: float | None = None
    """States per second to thin the demonstrations to [Hz]; None keeps all states."""
    gaps: Gaps = "refuse"
    """What to do if rows are missing."""

    def __post_init__(self) -> None:
        """Check the time step and the rate."""
        if self.dt is not None and not (math.isfinite(self.dt) and self.dt > 0):
            raise UsageError(f"--dt must be a positive number of seconds, got {self.dt}.")
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0):
            raise UsageError(f"--rate must be a positive number of states per second, got {self.rate}.")
        if self.dt is not None and self.time:
            raise UsageError("--dt and --time both say when rows were recorded; give one of them.")
        if self.as_recorded and self.rate is not None:
            raise UsageError("--as-recorded keeps all states, so it cannot be used with --rate.")


@dataclass(frozen=True)
class Imported:
    """The content of a source."""

    info: StateInfo
    """The meaning of the states."""
    episodes: Iterable[Episode]
    """The demonstrations in order. Most readers return a generator, which can be used once."""
    notices: tuple[str, ...] = ()
    """What the reader assumed, one line each."""
    keep_angles: bool = False
    """Whether to keep full turns in angles, instead of shifting each angle to end in (-pi, pi]."""
    exported: bool = False
    """Whether planspace exported the source: its states have a meaning already, and they are stored unchanged
    unless an option asks for something else."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of states by name that the source says and `info` does not."""
    uses: tuple["Use", ...] = ()
    """How the columns of a table are used; empty if the source is not a table."""
    splits: Mapping[str, Sequence[int]] = field(default_factory=dict)
    """Numbers of the demonstrations in each split that the source names, such as `train`; may be empty."""


@dataclass(frozen=True)
class Use:
    """What a column of a source is used for, for the table that the import prints."""

    name: str
    kind: str
    """`time`, `episode`, `state`, `control` or `unused`."""
    unit: str = ""
    """Its unit; empty if it is unknown."""
    note: str = ""
    """Why it is used so, if this was guessed or declared."""
    index: int = -1
    """Number of the state or of the control; -1 for other columns."""


def assignments(option: str, texts: Sequence[str], value: str = "COLUMN") -> dict[str, str]:
    """Parse repeated NAME=COLUMN arguments.

    Args:
        option: the option that they belong to, for messages.
        texts: the arguments; a column may contain equals signs.
        value: what the text after the equals sign is, for messages.

    Raises:
        UsageError: an argument is malformed, or a name is given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        name, equals, column = (part.strip() for part in text.partition("="))
        if not (name and equals and column):
            raise UsageError(f"{option} needs NAME={value}, got {text!r}.")
        if name in found:
            raise UsageError(f"{option} names {name!r} twice.")
        found[name] = column
    return found


def anonymous_info(num_states: int, num_controls: int) -> StateInfo:
    """Describe states without names: `state0`, `state1`, ..., with no angles."""
    names = tuple(f"state{i}" for i in range(num_states))
    return StateInfo(names, ("",) * num_states, (), num_controls)


def recorded(
    states: Float[np.ndarray, "time state"],
    controls: Float[np.ndarray, "step control"],
    times: Float[np.ndarray, " time"],
    index: int,
) -> Episode:
    """Build an episode without a known goal; times are shifted to start at 0.

    Args:
        states: T + 1 states.
        controls: T controls, each held until the next state.
        times: time of each state [s].
        index: number of the demonstration.
    """
    goal = np.full(states.shape[1], np.nan)
    return Episode(states, controls, times - times[0], goal, success=False, index=index, seed=0)


def finite_number(text: str) -> float:
    """Parse a finite number.

    Raises:
        ValueError: the text is not a finite number.
    """
    value = float(text)
    if not math.isfinite(value) or "_" in text:  # Python accepts 1_000; other programs do not
        raise ValueError(text)
    return value


def check_rising(times: Float[np.ndarray, " time"], place: Callable[[int], str]) -> None:
    """Check that times increase.

    Args:
        times: the times of one demonstration [s].
        place: returns where the i-th time is, such as `demo.csv, line 4`.

    Raises:
        PlanspaceError: a time is not later than the previous one. The message names its place.
    """
    bad = np.flatnonzero(np.diff(times) <= 0)
    if len(bad):
        i = int(bad[0]) + 1
        raise PlanspaceError(
            f"{place(i)}: the time {times[i]:.9g} does not come after {times[i - 1]:.9g}; times must "
            "increase within a demonstration."
        )


def check_options(options: ImportOptions, source: str, *usable: OptionName) -> None:
    """Refuse options that a format cannot use, instead of ignoring them.

    Args:
        options: the options of the user.
        source: the source, for messages.
        usable: the options that the format uses.

    Raises:
        UsageError: another option was given.
    """
    given = {
        "state": options.states,
        "control": options.controls,
        "dt": options.dt,
        "filter-key": options.filter_key,
        "time": options.time,
        "episode": options.episode,
    }
    reasons = {
        "dt": "has its own times",
        "filter-key": "has no lists of demonstrations",
        "time": "says itself when its rows were recorded",
        "episode": "says itself where its demonstrations begin",
    }
    for name, value in given.items():
        if value and name not in usable:
            why = reasons.get(name, "has no named columns to choose from")
            raise UsageError(f"--{name} cannot be used with {source}, which {why}; leave it out.")


def source_name(sources: Sequence[str]) -> str:
    """A short name for one or several files, for messages and for the manifest."""
    first = Path(sources[0]).name
    return first if len(sources) == 1 else f"{first} and {len(sources) - 1} more"
