"""The findings of a study: the results of its units, and the returns of each seed of its arms.

They are read from the units (`DIR/units`) or, if that folder is missing, from the study's `results.csv`
(`DIR/STUDY-BUDGET/results.csv`), so that a report can be written on any machine.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

from planspace.study.design import Arm, Study
from planspace.study.results import FitResult, Found, PlansResult, PoliciesResult, UnitResult
from planspace.study.stats import Scores
from planspace.study.unit import DemosUnit, FitUnit, PolicyUnit, Unit


@dataclass(frozen=True)
class Findings:
    """The results of a study so far."""

    study: Study
    results: Mapping[str, UnitResult]
    """The result of each finished unit, by the unit's name."""
    scores: Mapping[str, Scores]
    """The returns of each arm's finished seeds, by the arm's name."""
    versions: Mapping[str, str]
    """Versions of planspace and its libraries that the units were run with."""

    def of(self, study: Study) -> "Findings":
        """The findings of a study that has some of the arms of this one."""
        arms, units = ({x.name for x in part} for part in (study.arms, study.units))
        return replace(
            self,
            study=study,
            results={name: result for name, result in self.results.items() if name in units},
            scores={name: scores for name, scores in self.scores.items() if name in arms},
        )

    def panels(self) -> dict[str, list[Arm]]:
        """The arms with scores, by figure."""
        panels: dict[str, list[Arm]] = {}
        for arm in self.study.arms:
            if arm.name in self.scores:
                panels.setdefault(arm.panel, []).append(arm)
        return panels

    def done(self, unit: Unit) -> bool:
        """Whether a unit is finished."""
        return unit.name in self.results

    def demos(self, unit: DemosUnit) -> PlansResult:
        """The result of a finished unit that makes demonstrations."""
        return cast(PlansResult, self._found(unit))

    def fit(self, unit: FitUnit) -> FitResult:
        """The result of a finished embedding unit."""
        return cast(FitResult, self._found(unit))

    def policies(self, unit: PolicyUnit) -> PoliciesResult:
        """The result of a finished policy unit."""
        return cast(PoliciesResult, self._found(unit))

    def _found(self, unit: Unit) -> Found:
        return self.results[unit.name].found


def named_fits(findings: Findings) -> dict[str, FitUnit]:
    """The finished embeddings. An embedding is named after the first arm that uses it, and its seed."""
    named: dict[str, FitUnit] = {}
    seen: set[str] = set()
    for arm in findings.study.arms:
        for fit in arm.units[0].fits:
            if findings.done(fit) and fit.name not in seen:
                seen.add(fit.name)
                label = f"{fit.plans.problem_name}: {arm.label}"
                several = len(arm.units[0].fits) > 1
                name = f"{label}, seed {fit.seed}" if several else label
                named[name if name not in named else f"{name} ({arm.panel})"] = fit
    return named
