"""A study's results as plain data: what the tables, the figures and the report are made of.

Everything comes from the results of its units (`DIR/units`), so a report can be written on another machine
than the one that ran them.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planspace.rl.config import BATCH_STEPS
from planspace.study import stats
from planspace.study.design import SPREADS, Arm, Claim, Study
from planspace.study.eta import Pace
from planspace.study.execute import is_done, read_result
from planspace.study.stats import Scores, Verdict
from planspace.study.unit import FitUnit, PlansUnit, Unit
from planspace.tasks.catalog import find_task


@dataclass(frozen=True)
class Findings:
    """What is known of a study."""

    study: Study
    results: dict[str, dict[str, Any]]
    """What came of each unit that is done, by its name."""
    scores: dict[str, Scores]
    """The seeds of each arm of which any have been run, by its name."""

    def panels(self) -> dict[str, list[Arm]]:
        """The arms with scores, by figure."""
        panels: dict[str, list[Arm]] = {}
        for arm in self.study.arms:
            if arm.name in self.scores:
                panels.setdefault(arm.panel, []).append(arm)
        return panels

    def found(self, unit: Unit) -> dict[str, Any]:
        """What came of a unit that is done."""
        return self.results[unit.name]["found"]


def read_findings(study: Study, out: Path) -> Findings:
    """Reads what a study has found so far.

    Args:
        study: the study.
        out: the folder of the studies.

    Raises:
        PlanspaceError: a result is damaged.
    """
    results = {unit.name: read_result(unit, out) for unit in study.units if is_done(unit, out)}
    scores = {}
    for arm in study.arms:
        if found := [results[unit.name]["found"] for unit in arm.units if unit.name in results]:
            scores[arm.name] = Scores.of(arm, found)
    return Findings(study, results, scores)


def summarise(findings: Findings) -> dict[str, Any]:
    """The tables of a study.

    Returns:
        `panels`: for each figure its rows, of which the first is what the others are compared with;
        `over_tasks`: what each arm reached on all its tasks; `claims`; `embeddings`; `plans`; and `time`.
    """
    study = findings.study
    return {
        "study": study.name,
        "budget": study.budget,
        "steps": study.arms[0].units[0].config.steps,
        "question": study.question,
        "units": {"done": len(findings.results), "all": len(study.units)},
        "panels": {
            panel: [_row(findings, arm, arms[0]) for arm in arms] for panel, arms in findings.panels().items()
        },
        "over_tasks": _over_tasks(findings),
        "claims": [_claim(findings, i) for i in range(len(study.claims))],
        "embeddings": [
            {"name": name, **_embedding(findings, unit)} for name, unit in named_fits(findings).items()
        ],
        "plans": [_plans(findings, unit) for unit in study.units if _is(PlansUnit, unit, findings)],
        "time": _time(findings),
    }


def named_fits(findings: Findings) -> dict[str, FitUnit]:
    """The embeddings that are done, each by the first arm that uses it and its seed."""
    named: dict[str, FitUnit] = {}
    seen: set[str] = set()
    for arm in findings.study.arms:
        for fit in arm.units[0].fits:
            if fit.name in findings.results and fit.name not in seen:
                seen.add(fit.name)
                label = f"{fit.plans.problem}: {arm.label}"
                several = len(arm.units[0].fits) > 1
                name = f"{label}, seed {fit.seed}" if several else label
                named[name if name not in named else f"{name} ({arm.panel})"] = fit
    return named


def _row(findings: Findings, arm: Arm, first: Arm) -> dict[str, Any]:
    scores, base = findings.scores[arm.name], findings.scores[first.name]
    x = stats.final(scores)
    config = arm.units[0].config
    solved = find_task(config.task).solved_return if config.reward == "dense" else None
    improved = stats.probability_of_improvement(x, stats.final(base))
    return {
        "arm": arm.label,
        "seeds": len(x),
        "planned": _planned(arm),
        "embeddings": arm.num_embeddings,
        "frozen": scores.frozen,
        "mean": float(x.mean()),
        "mean_interval": stats.interval(scores, stats.mean, x),
        "iqm": float(stats.iqm(x)),
        "iqm_interval": stats.interval(scores, stats.iqm, x),
        "worst": float(x.min()),
        "best": float(x.max()),
        "deviation": float(np.exp(stats.log_deviation(x))) if len(x) > 1 else 0.0,
        "ratio": _ratio(scores, base) if arm is not first else None,
        "improvement": improved if arm is not first else None,
        "whole": float(stats.whole(scores).mean()),
        "solved": float((x > solved).mean()) if solved is not None else None,
        "steps_to_solved": _median_steps(scores, solved),
        "components": stats.variance_components(scores, x),
    }


def _over_tasks(findings: Findings) -> list[dict[str, Any]]:
    """The interquartile mean of each arm that was run on all tasks, over tasks and seeds."""
    tasks = {arm.task for arm in findings.study.arms}
    found: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    for arm in findings.study.arms:
        config = arm.units[0].config
        levels = find_task(config.task).return_range
        if arm.name in findings.scores and config.reward == "dense" and levels is not None:
            low, high = levels
            normalised = (stats.final(findings.scores[arm.name]) - low) / (high - low)
            found.setdefault((config.algo.upper(), arm.label), {})[arm.task] = normalised
    rows = []
    for (algo, label), samples in found.items():
        if len(samples) > 1 and samples.keys() == tasks:
            number, interval = stats.iqm_over_tasks(list(samples.values()))
            row = {"algo": algo, "arm": label, "tasks": len(samples), "iqm": number}
            rows.append({**row, "iqm_interval": interval})
    several = {a["algo"] for a in rows for b in rows if a["algo"] == b["algo"] and a is not b}
    return [row for row in rows if row["algo"] in several]  # one arm alone is compared with nothing


def _ratio(scores: Scores, base: Scores) -> tuple[float, stats.Interval] | None:
    """Deviation over seeds of the first arm over this one's, with its interval; None where all are alike."""
    shared = tuple(seed for seed in scores.seeds if seed in base.seeds)
    both = scores.of_seeds(shared), base.of_seeds(shared)
    if len(shared) < 3 or min(np.ptp(stats.final(x)) for x in both) == 0.0:
        return None
    log, (low, high) = stats.deviation_ratio(*both)
    return float(np.exp(log)), (float(np.exp(low)), float(np.exp(high)))


def _median_steps(scores: Scores, solved: float | None) -> float | None:
    """Steps until half of the seeds are above the threshold; None where fewer ever are."""
    if solved is None:
        return None
    steps = np.sort(stats.steps_to(scores, solved))
    half = float(steps[(len(steps) + 1) // 2 - 1])
    return half if np.isfinite(half) else None


def _claim(findings: Findings, number: int) -> dict[str, Any]:
    claim = findings.study.claims[number]
    arms = [arm for arm in findings.study.arms if arm.name in (claim.arm, claim.other)]
    scores = [findings.scores.get(name) for name in (claim.arm, claim.other) if name]
    arm, other = (*scores, None)[:2]
    if arm is None or None in scores:
        verdict = Verdict(np.nan, (np.nan, np.nan), 0, "not run yet")
    else:
        verdict = stats.judge(claim, arm, other)
        if any(len(findings.scores[x.name].seeds) < _planned(x) for x in arms):
            verdict = replace(verdict, verdict="not finished")  # to look in between and stop is no test
    found = {**asdict(claim), **asdict(verdict), "rule": _rule(claim, arms)}
    if not np.isfinite(verdict.number):
        return {**found, "number": None, "interval": None}
    if claim.measure in SPREADS:  # judged by its logarithm, read as a ratio
        low, high = verdict.interval
        return found | {
            "number": float(np.exp(verdict.number)),
            "interval": tuple(np.exp((low, high)).tolist()),
        }
    return found


def _rule(claim: Claim, arms: list[Arm]) -> str:
    """What makes a claim hold, in words: final: low-Z augment - raw > 0."""
    several_panels = len({arm.panel for arm in arms}) > 1
    names = {arm.name: f"{arm.label} ({arm.panel})" if several_panels else arm.label for arm in arms}
    arm, other = (names.get(name, name) for name in (claim.arm, claim.other))
    if claim.measure in SPREADS:
        when = " early" if claim.measure == "early_spread" else ""
        return f"deviation{when}: {other} / {arm} > 1"
    number = f"{claim.measure}: {arm}" + (f" − {other}" if other else "")
    if claim.expects == "same":
        return f"{number} within ±{claim.margin:g}"
    return f"{number} > {claim.margin:g}" if claim.expects == "more" else f"{number} < {-claim.margin or 0:g}"


def _planned(arm: Arm) -> int:
    return sum(unit.config.num_seeds for unit in arm.units)


def _embedding(findings: Findings, unit: FitUnit) -> dict[str, Any]:
    found = findings.found(unit)
    return {
        "demos": findings.found(unit.plans)["count"],
        "z_dim": unit.config.z_dim,
        "seed": found["seed"],
        **found["metrics"],
    }


def _plans(findings: Findings, unit: Unit) -> dict[str, Any]:
    found = findings.found(unit)
    assert isinstance(unit, PlansUnit)
    return {"problem": unit.problem, "source": unit.source, "settings": dict(unit.settings), **found}


def _is(kind: type, unit: Unit, findings: Findings) -> bool:
    return isinstance(unit, kind) and unit.name in findings.results


def _time(findings: Findings) -> dict[str, int]:
    """What the finished units took, and what the whole study will."""
    pace = Pace.of(findings.study.units, findings.results)
    return {
        "timed_units": pace.timed,
        "timed_core_seconds": round(pace.core_seconds),
        "whole_core_seconds": round(sum(pace.expect(unit) for unit in findings.study.units)),
        "not_timed": sum(not pace.knows(unit) for unit in findings.study.units),
    }


# --- as text --------------------------------------------------------------------------------------------


def as_text(summary: dict[str, Any]) -> str:
    """The tables for a terminal."""
    units = summary["units"]
    lines = [f"study {summary['study']}, budget {summary['budget']}: {units['done']} of {units['all']} units"]
    for panel, rows in summary["panels"].items():
        head = f"{panel}: return over the last {stats.FINAL_STEPS // BATCH_STEPS} iterations"
        lines += ["", f"{head:<64}{'mean':>9}{'95 % interval':>20}{'worst':>9}{'best':>9}{'seeds':>7}"]
        for row in rows:
            low, high = row["mean_interval"]
            line = f"  {row['arm']:<62}{row['mean']:>9.1f}{f'({low:.1f}, {high:.1f})':>20}"
            lines.append(f"{line}{row['worst']:>9.1f}{row['best']:>9.1f}{row['seeds']:>7}")
    if summary["claims"]:
        lines += ["", f"{'claim':<82}{'number':>9}{'95 % interval':>20}  verdict"]
    for claim in summary["claims"]:
        if claim["interval"] is None:
            lines.append(f"  {claim['text']:<80}{'':>29}  {claim['verdict']}")
            continue
        low, high = claim["interval"]
        number = f"{claim['number']:>9.2f}{f'({low:.2f}, {high:.2f})':>20}"
        lines.append(f"  {claim['text']:<80}{number}  {claim['verdict']}")
    return "\n".join(lines)
