"""What the importers have in common: options, a demonstration as a file has it, and what a source gave."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Episode, StateInfo
from planspace.errors import PlanspaceError, UsageError


@dataclass(frozen=True)
class ImportOptions:
    """How a source is read."""

    states: dict[str, str] = field(default_factory=dict)
    """State name to the column, or the number of an observation, that holds it."""
    controls: dict[str, str] = field(default_factory=dict)
    """Control name (`control1` ..., or an actuator's) to the column that holds it."""
    dt: float | None = None
    """Seconds between states, for a source that does not say when they were recorded."""
    as_recorded: bool = False
    """Keep uneven time steps and wound-up angles; the study of the 2020 data needs both."""

    def __post_init__(self) -> None:
        """Refuses a time step that is none."""
        if self.dt is not None and not (math.isfinite(self.dt) and self.dt > 0):
            raise UsageError(f"--dt must be a positive number of seconds, got {self.dt}.")


@dataclass(frozen=True)
class Imported:
    """What a source holds."""

    info: StateInfo
    episodes: Iterable[Episode]
    """The demonstrations in order; most sources are read as they are asked for, once."""
    notices: tuple[str, ...] = ()
    """What was assumed, one line each."""
    keep_angles: bool = False
    """Whether angles stay where the file has them, instead of ending in (-pi, pi]."""


def assignments(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Reads repeated NAME=COLUMN arguments.

    Args:
        option: the option they were given to, for messages.
        texts: each `NAME=COLUMN`; the column may hold further equals signs.

    Raises:
        UsageError: there is no equals sign, a side is empty, or a name comes twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        name, equals, column = (part.strip() for part in text.partition("="))
        if not (name and equals and column):
            raise UsageError(f"{option} needs NAME=COLUMN, got {text!r}.")
        if name in found:
            raise UsageError(f"{option} names {name!r} twice.")
        found[name] = column
    return found


def anonymous_info(num_states: int, num_controls: int) -> StateInfo:
    """What is known of states that come without names: `state0`, `state1` ..., none of them circular."""
    names = tuple(f"state{i}" for i in range(num_states))
    return StateInfo(names, ("",) * num_states, (), num_controls)


def recorded(
    states: Float[np.ndarray, "time state"],
    controls: Float[np.ndarray, "step control"],
    times: Float[np.ndarray, " time"],
    index: int,
) -> Episode:
    """An episode of which no more is known than its course; its clock is set to start at 0.

    Args:
        states: T + 1 states.
        controls: T controls, each held until the next state.
        times: when each state was reached [s].
        index: its number among the demonstrations.
    """
    goal = np.full(states.shape[1], np.nan)
    return Episode(states, controls, times - times[0], goal, success=False, index=index, seed=0)


def finite_number(text: str) -> float:
    """Reads a number.

    Raises:
        ValueError: it is none, or not finite.
    """
    value = float(text)
    if not math.isfinite(value) or "_" in text:  # Python reads 1_000 as a number; other programs do not
        raise ValueError(text)
    return value


def check_rising(times: Float[np.ndarray, " time"], place: Callable[[int], str]) -> None:
    """Refuses times that stand still or go back.

    Args:
        times: the times of one demonstration [s].
        place: where a time stands by its number, such as `demo.csv, line 4`.

    Raises:
        PlanspaceError: some time is not later than the one before it (its place is named).
    """
    bad = np.flatnonzero(np.diff(times) <= 0)
    if len(bad):
        i = int(bad[0]) + 1
        raise PlanspaceError(
            f"{place(i)}: the time {times[i]:.9g} does not come after {times[i - 1]:.9g}; the states of a "
            "demonstration must be in order, each at its own time."
        )


def refuse(options: ImportOptions, source: str, *, states: bool, controls: bool, dt: bool) -> None:
    """Refuses options that a kind of source cannot use, rather than passing over them.

    Args:
        options: what was asked for.
        source: the source, for messages.
        states: whether `--state` has a meaning here.
        controls: whether `--control` has one.
        dt: whether `--dt` has one.

    Raises:
        UsageError: an option was given that has none.
    """
    given = {"--state": options.states, "--control": options.controls, "--dt": options.dt}
    usable = {"--state": states, "--control": controls, "--dt": dt}
    for option, value in given.items():
        if value and not usable[option]:
            why = "has times of its own" if option == "--dt" else "has no named columns to choose from"
            raise UsageError(f"{option} has no meaning for {source}, which {why}; leave it out.")
