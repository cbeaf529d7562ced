"""Estimated times of units: a guess from their settings, corrected by the units that have been timed."""

import heapq
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

from planspace.seams import name_of
from planspace.study.results import UnitResult
from planspace.study.unit import PolicyUnit, Unit


class Timings:
    """Core seconds of units, by kind and algorithm."""

    def __init__(self) -> None:
        """Start without timed units."""
        self.num_timed = 0
        """Number of timed units."""
        self._taken: defaultdict[str, float] = defaultdict(float)
        self._guessed: defaultdict[str, float] = defaultdict(float)

    @classmethod
    def of(cls, units: Iterable[Unit], results: Mapping[str, UnitResult]) -> "Timings":
        """Timings of the units that have a result and were not interrupted."""
        timings = cls()
        for unit in units:
            result = results.get(unit.name)
            if result is not None and not result.resumed:
                timings.add(unit, result.core_seconds)
        return timings

    def add(self, unit: Unit, core_seconds: float) -> None:
        """Record the time of a unit."""
        self.num_timed += 1
        self._taken[_kind(unit)] += core_seconds
        self._guessed[_kind(unit)] += unit.cost

    @property
    def core_seconds(self) -> float:
        """Total time of the timed units."""
        return sum(self._taken.values(), 0.0)

    def has_kind(self, unit: Unit) -> bool:
        """Whether a unit of this kind and algorithm has been timed."""
        return _kind(unit) in self._taken

    def estimate(self, unit: Unit) -> float:
        """Core seconds of a unit: its guess, scaled by the measured over the guessed time of its kind."""
        kind = _kind(unit)
        return unit.cost * (self._taken[kind] / self._guessed[kind] if self.has_kind(unit) else 1.0)


def time_left(
    waiting: Sequence[Unit], running: Mapping[str, float], timings: Timings, size: int, cores: float = 1.0
) -> float:
    """Estimate the seconds until all units are finished.

    The estimate follows the units through the pool. It therefore includes the times at which a part of the
    pool is idle: while units wait for others that they need, and at the end.

    Args:
        waiting: the units that wait, in the order in which they are started.
        running: seconds until each running unit ends, by the unit's name.
        timings: estimates the waiting units.
        size: number of units that run at a time.
        cores: number of cores of each running unit.
    """
    ends = [(seconds, name) for name, seconds in running.items()]
    heapq.heapify(ends)
    seconds = {unit.name: timings.estimate(unit) / cores for unit in waiting}
    pending = running.keys() | seconds.keys()
    missing = {unit.name: {need.name for need in unit.needs} & pending for unit in waiting}
    now = 0.0
    while ends or missing:
        ready = [name for name, needs in missing.items() if not needs]
        for name in ready[: size - len(ends)]:
            del missing[name]
            heapq.heappush(ends, (now + seconds[name], name))
        now, ended = heapq.heappop(ends)
        for needs in missing.values():
            needs.discard(ended)
    return now


def _kind(unit: Unit) -> str:
    return f"{unit.kind} {name_of(unit.config.algorithm)}" if isinstance(unit, PolicyUnit) else unit.kind
