"""Cleaning of the rows of imported demonstrations: duplicate, late and missing rows.

Everything that is changed or found is counted, with its first places.
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from planspace.demos.episode import Episode
from planspace.demos.findings import Finding
from planspace.demos.recording import Gaps, check_rising
from planspace.errors import PlanspaceError

MOST_LATE = 0.1
"""If a larger fraction of rows comes after a later row, the rows are not late: the clock starts again."""
GAP_FACTOR, GAP_QUANTILE = 5.0, 0.9
"""A step is a gap if it is this many times as long as all but the longest tenth of the steps."""


@dataclass
class Cleaning:
    """Counts of what was cleaned."""

    late: Finding = field(default_factory=Finding)
    repeated: Finding = field(default_factory=Finding)
    single: Finding = field(default_factory=Finding)
    gaps: Finding = field(default_factory=Finding)

    def clean_rows(self, episodes: Iterable[Episode], *, as_recorded: bool) -> Iterator[Episode]:
        """Sort late rows, keep the last of rows with equal times, and leave out demonstrations of one state.

        Args:
            episodes: the demonstrations as recorded.
            as_recorded: refuse late and repeated rows instead.

        Raises:
            PlanspaceError: the time goes back for many rows, as where another demonstration begins.
        """
        for episode in episodes:
            if as_recorded:
                check_rising(episode.times, episode.place)
            elif not (np.diff(episode.times) > 0).all():
                episode = self._with_rising_times(episode)
            if len(episode.states) < 2:
                self.single.add(episode.place(0))
            else:
                yield episode

    def _with_rising_times(self, episode: Episode) -> Episode:
        times = episode.times
        late = np.flatnonzero(times < np.maximum.accumulate(times))
        if len(late) > max(1.0, MOST_LATE * len(times)):
            first, num = int(late[0]), int((np.diff(times) < 0).sum())
            raise PlanspaceError(
                f"{episode.place(first)}: the time goes back from {times[first - 1]:.9g} to "
                f"{times[first]:.9g} s, the first of {num} such rows. If a new demonstration begins there, "
                "name the column that tells demonstrations apart with --episode NAME; with the name of the "
                "time, a demonstration begins wherever the time goes back."
            )
        order = np.argsort(times, kind="stable")
        last = np.diff(times[order], append=np.inf) > 0
        for i in late.tolist():
            self.late.add(episode.place(i))
        for i in order[~last].tolist():
            self.repeated.add(episode.place(i))
        return take_rows(episode, order[last])

    def split_gaps(self, episodes: Iterable[Episode], longest: float, choice: Gaps) -> Iterator[Episode]:
        """Find steps that are longer than `longest`, and cut demonstrations there if the user chose it.

        Args:
            episodes: the demonstrations.
            longest: the longest step that is no gap [s].
            choice: what to do. `refuse` only counts, see `check_gaps`.
        """
        for episode in episodes:
            gaps = np.flatnonzero(np.diff(episode.times) > longest)
            for i in gaps.tolist():
                step = episode.times[i + 1] - episode.times[i]
                self.gaps.add(f"{episode.place(i + 1)}: {step:.4g} s")
            if not len(gaps) or choice != "split":
                yield episode
                continue
            bounds = [0, *(gaps + 1).tolist(), len(episode.times)]
            for start, stop in itertools.pairwise(bounds):
                if stop - start < 2:
                    self.single.add(episode.place(start))
                else:
                    yield _piece(episode, start, stop)

    def check_gaps(self, longest: float) -> None:
        """Refuse demonstrations with gaps.

        Raises:
            PlanspaceError: there are gaps; the message counts them and names the first.
        """
        if self.gaps.count:
            found = self.gaps.text("gap", "gaps")
            raise PlanspaceError(
                f"{found}: rows are missing where a step is longer than {longest:.4g} s. Give --gaps split "
                "to cut the demonstrations there, or --gaps fill to interpolate."
            )

    def notices(self, choice: Gaps) -> list[str]:
        """One line for each kind of cleaning that was necessary."""
        how = {"split": "the demonstration is cut there", "fill": "filled by interpolation", "refuse": "kept"}
        lines = (
            (self.late, "row is late: sorted by time", "rows are late: sorted by time"),
            (
                self.repeated,
                "row has the time of the next one: left out",
                "rows have the time of the next one: left out",
            ),
            (self.single, "demonstration has one state: left out", "demonstrations have one state: left out"),
            (self.gaps, f"gap: {how[choice]}", f"gaps: {how[choice]}"),
        )
        return [finding.text(one, many) for finding, one, many in lines if finding.count]


def longest_step(steps: np.ndarray) -> float:
    """The longest step that is no gap [s]; steps that are uneven on purpose are no gaps.

    Args:
        steps: the durations of all steps [s]; at least one.
    """
    return GAP_FACTOR * float(np.quantile(steps, GAP_QUANTILE))


def take_rows(episode: Episode, rows: np.ndarray) -> Episode:
    """Some rows of a demonstration with the controls that are held from them on; the clock starts at 0.

    Args:
        episode: the demonstration.
        rows: the rows in the order of their times.
    """
    controls = np.concatenate([episode.controls, episode.controls[-1:]])[rows[:-1]]
    times = episode.times[rows]
    return replace(
        episode,
        states=episode.states[rows],
        controls=controls,
        times=times - times[0],
        origin=episode.origin.take(rows) if episode.origin else None,
    )


def _piece(episode: Episode, start: int, stop: int) -> Episode:
    piece = take_rows(episode, np.arange(start, stop))
    if stop == len(episode.times):
        return piece
    return replace(piece, goal=np.full_like(episode.goal, np.nan), success=False)
