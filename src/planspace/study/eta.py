"""How long units take: guessed from their settings, corrected by those that have been timed."""

from collections import defaultdict
from collections.abc import Iterable, Mapping

from planspace.seams import name_of
from planspace.study.results import UnitResult
from planspace.study.unit import PolicyUnit, Unit


class Pace:
    """Core seconds of units, by kind and algorithm."""

    def __init__(self) -> None:
        """Nothing has been timed yet."""
        self.timed = 0
        """How many units have been."""
        self._taken: defaultdict[str, float] = defaultdict(float)
        self._guessed: defaultdict[str, float] = defaultdict(float)

    @classmethod
    def of(cls, units: Iterable[Unit], results: Mapping[str, UnitResult]) -> "Pace":
        """That of the units which have a result, by name, and were run in one go."""
        pace = cls()
        for unit in units:
            result = results.get(unit.name)
            if result is not None and not result.resumed:
                pace.add(unit, result.core_seconds)
        return pace

    def add(self, unit: Unit, core_seconds: float) -> None:
        """Takes down what a unit took."""
        self.timed += 1
        self._taken[_kind(unit)] += core_seconds
        self._guessed[_kind(unit)] += unit.cost

    @property
    def core_seconds(self) -> float:
        """What the timed units took together."""
        return sum(self._taken.values(), 0.0)

    def knows(self, unit: Unit) -> bool:
        """Whether one of its kind has been timed."""
        return _kind(unit) in self._taken

    def expect(self, unit: Unit) -> float:
        """Core seconds that a unit will take: its guess, times what its kind has taken over its guesses."""
        kind = _kind(unit)
        return unit.cost * (self._taken[kind] / self._guessed[kind] if self.knows(unit) else 1.0)


def _kind(unit: Unit) -> str:
    return f"{unit.kind} {name_of(unit.config.algorithm)}" if isinstance(unit, PolicyUnit) else unit.kind
