"""Estimated times of units: a guess from their settings, corrected by the units that have been timed."""

from collections import defaultdict
from collections.abc import Iterable, Mapping

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


def _kind(unit: Unit) -> str:
    return f"{unit.kind} {name_of(unit.config.algorithm)}" if isinstance(unit, PolicyUnit) else unit.kind
