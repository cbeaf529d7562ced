"""Numbers that look wrong or rough but are kept: outliers, and states that move in ticks of a sensor."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from planspace.demos.episode import Episode
from planspace.demos.findings import Finding
from planspace.demos.survey import Survey

JUMP_OF_RANGE, JUMP_OF_STEPS = 0.5, 20.0
"""An outlier differs from the states before and after it by this fraction of the range of its column, and by
this many average steps."""
MOST_TICKS, FEWEST_LEVELS, LEAST_MOVING = 3.0, 10, 0.2
"""A state moves in ticks if its average step has at most this many of them, it has at least this many levels,
and it moves in at least this fraction of the rows: a switch does not."""
MAX_STATES = 5
"""Number of states that a line about outliers names."""
WHOLE = 0.01
"""A number of ticks may differ from a whole number by this much."""


class Suspects:
    """Outliers and ticks, found one demonstration at a time."""

    def __init__(self, names: Sequence[str], survey: Survey, rotations: Sequence[int]):
        """Start without findings.

        Args:
            names: names of the states.
            survey: statistics of the same states.
            rotations: angles on a circle and quaternions, which may jump.
        """
        self._names, self._survey = names, survey
        self._jump = np.maximum(
            JUMP_OF_RANGE * (survey.high - survey.low), JUMP_OF_STEPS * survey.average_step
        )
        self._jump[list(rotations)] = np.inf
        self._outliers: dict[int, Finding] = {}
        self._ticked: Bool[np.ndarray, " state"] = self._moves_in_few_ticks()

    def watch(self, episodes: Iterable[Episode]) -> Iterator[Episode]:
        """Pass on demonstrations unchanged, and look at them."""
        for episode in episodes:
            if len(episode.states) > 2:
                self._update(episode)
            yield episode

    def notices(self) -> list[str]:
        """A line for the outliers and a line for the ticks, if there are any."""
        lines = []
        if self._outliers:
            num = sum(found.count for found in self._outliers.values())
            first = [f"{self._names[c]} ({found.places[0]})" for c, found in sorted(self._outliers.items())]
            more = f" and {len(first) - MAX_STATES} more states" if len(first) > MAX_STATES else ""
            what = "outlier is kept: in" if num == 1 else "outliers are kept, the first in"
            lines.append(f"{num} {what} {', '.join(first[:MAX_STATES])}{more}")
        if ticked := np.flatnonzero(self._ticked).tolist():
            ticks = ", ".join(f"{self._names[c]} ({self._survey.least_step[c]:.3g})" for c in ticked)
            lines.append(
                f"the sensor ticks are as large as most steps of {ticks}: a lower --rate makes steps larger."
            )
        return lines

    def _update(self, episode: Episode) -> None:
        steps = np.diff(episode.states, axis=0)
        to, back = steps[:-1], -steps[1:]
        found = (np.minimum(np.abs(to), np.abs(back)) > self._jump) & (np.sign(to) == np.sign(back))
        for row, column in np.argwhere(found).tolist():
            place = f"{episode.place(row + 1)}: {episode.states[row + 1, column]:.4g}"
            self._outliers.setdefault(column, Finding()).add(place)
        if self._ticked.any():
            self._ticked &= self._are_whole(steps)

    def _moves_in_few_ticks(self) -> Bool[np.ndarray, " state"]:
        survey = self._survey
        with np.errstate(divide="ignore", invalid="ignore"):
            few = survey.average_step <= MOST_TICKS * survey.least_step * survey.moving
            levels = (survey.high - survey.low) / survey.least_step >= FEWEST_LEVELS
        return few & levels & (survey.moving >= LEAST_MOVING)

    def _are_whole(self, steps: Float[np.ndarray, "step state"]) -> Bool[np.ndarray, " state"]:
        with np.errstate(divide="ignore", invalid="ignore"):
            ticks = steps / self._survey.least_step
        return np.all(np.abs(ticks - np.round(ticks)) <= WHOLE, axis=0)
