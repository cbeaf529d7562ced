"""Compute the tables of a study from its results."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from planspace.seams import name_of
from planspace.storage.checks import CONFIG
from planspace.storage.json_files import read_json
from planspace.study import stats
from planspace.study.design import SPREADS, Arm, Claim, Study, all_needs, solved_level
from planspace.study.eta import Timings
from planspace.study.execute import is_done, read_result
from planspace.study.findings import Findings, named_fits
from planspace.study.stats import Scores, Verdict
from planspace.study.tables import (
    NOT_RUN,
    ArmRow,
    ClaimRow,
    CostRow,
    EmbeddingRow,
    Estimate,
    OverTasksRow,
    PlansRow,
    StudySummary,
    Time,
)
from planspace.study.tidy import FILE, read_tidy
from planspace.study.unit import DemosUnit, FitUnit, GuideUnit, PlansUnit, Unit
from planspace.tasks.catalog import find_task

ABOUT = "study.json"
"""Describes the `results.csv` next to it: the study, its arms and the versions."""


def folder_of_study(study: Study, out: Path) -> Path:
    """The folder of a study's report and `results.csv`."""
    return out / (study.folder or f"{study.name}-{study.budget}")


def read_findings(study: Study, out: Path) -> Findings:
    """Read the results of a study so far: from its units or, if there are none, from its `results.csv`.

    Args:
        study: the study.
        out: the folder of the studies.

    Raises:
        PlanspaceError: a result is damaged.
    """
    folder = folder_of_study(study, out)
    if not (out / "units").exists() and (folder / FILE).exists():
        return read_tidy(study, folder / FILE, read_json(folder / ABOUT)["versions"])
    results = {unit.name: read_result(unit, out) for unit in study.units if is_done(unit, out)}
    versions = read_json(out / CONFIG)["versions"] if (out / CONFIG).exists() else {}
    findings = Findings(study, results, {}, versions)
    scores = {}
    for arm in study.arms:
        if found := [findings.policies(unit) for unit in arm.units if findings.done(unit)]:
            scores[arm.name] = Scores.of(arm, found, evaluated=study.evaluated)
    return replace(findings, scores=scores)


def summarise(findings: Findings) -> StudySummary:
    """Compute the tables of a study."""
    study = findings.study
    demos = [x for x in study.units if isinstance(x, PlansUnit | GuideUnit) and findings.done(x)]
    steps = [arm.units[0].config.steps for arm in study.arms]
    return StudySummary(
        study=study.name,
        budget=study.budget,
        steps=max(steps),
        least_steps=min(steps),
        evaluated=study.evaluated,
        question=study.question,
        units_done=len(findings.results),
        units_all=len(study.units),
        panels={
            panel: [_row(findings, arm, arms[0]) for arm in arms] for panel, arms in findings.panels().items()
        },
        over_tasks=_over_tasks(findings),
        claims=[_claim(findings, claim) for claim in study.claims],
        embeddings=[_embedding(findings, name, unit) for name, unit in named_fits(findings).items()],
        plans=[_demos(findings, unit) for unit in demos],
        costs=[_cost(findings, arm) for arms in findings.panels().values() for arm in arms],
        time=_time(findings),
    )


def _row(findings: Findings, arm: Arm, first: Arm) -> ArmRow:
    scores, base = findings.scores[arm.name], findings.scores[first.name]
    x = stats.final(scores)
    solved = solved_level(arm)
    improved = stats.probability_of_improvement(x, stats.final(base))
    return ArmRow(
        arm=arm.label,
        seeds=len(x),
        planned=_planned(arm),
        embeddings=arm.num_embeddings,
        diverged=sum(scores.diverged),
        mean=float(x.mean()),
        mean_interval=stats.interval(scores, stats.mean, x),
        iqm=float(stats.iqm(x)),
        iqm_interval=stats.interval(scores, stats.iqm, x),
        worst=float(x.min()),
        best=float(x.max()),
        standard_deviation=float(np.exp(stats.log_std(x))) if len(x) > 1 else 0.0,
        ratio=_ratio(scores, base) if arm is not first else None,
        improvement=improved if arm is not first else None,
        whole=float(stats.whole(scores).mean()),
        solved=float((x > solved).mean()) if solved is not None else None,
        steps_to_solved=_median_steps(scores, solved),
        components=stats.variance_components(scores, x),
    )


def _over_tasks(findings: Findings) -> list[OverTasksRow]:
    """The interquartile mean over tasks and seeds of each arm that was run on all tasks."""
    tasks = {arm.task for arm in findings.study.arms}
    found: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    for arm in findings.study.arms:
        unit = arm.units[0]
        if arm.name in findings.scores and (levels := _levels(arm)) is not None:
            low, high = levels
            normalised = (stats.final(findings.scores[arm.name]) - low) / (high - low)
            found.setdefault((name_of(unit.config.algorithm).upper(), arm.label), {})[arm.task] = normalised
    rows = []
    for (algo, label), samples in found.items():
        if len(samples) > 1 and samples.keys() == tasks:
            rows.append(OverTasksRow(algo, label, len(samples), *stats.iqm_over_tasks([*samples.values()])))
    counts = {row.algo: sum(other.algo == row.algo for other in rows) for row in rows}
    return [row for row in rows if counts[row.algo] > 1]  # a single arm cannot be compared


def _levels(arm: Arm) -> tuple[float, float] | None:
    """Returns that count as 0 and 1 in averages over tasks; None if the task has none."""
    unit = arm.units[0]
    task = find_task(unit.task)
    return {"dense": task.return_range, "sparse": (0.0, float(task.horizon))}.get(unit.config.reward)


def _ratio(scores: Scores, base: Scores) -> Estimate | None:
    """Ratio of standard deviations, first arm over this arm; None if all seeds of an arm are equal."""
    shared = tuple(seed for seed in scores.seeds if seed in base.seeds)
    both = scores.of_seeds(shared), base.of_seeds(shared)
    if len(shared) < 3 or min(np.ptp(stats.final(x)) for x in both) == 0.0:
        return None
    log, (low, high) = stats.log_std_ratio(*both)
    return float(np.exp(log)), (float(np.exp(low)), float(np.exp(high)))


def _median_steps(scores: Scores, solved: float | None) -> float | None:
    """Steps until half of the seeds have solved the task; None if fewer than half ever do."""
    if solved is None:
        return None
    steps = np.sort(stats.steps_to(scores, solved))
    half = float(steps[(len(steps) + 1) // 2 - 1])
    return half if np.isfinite(half) else None


def _claim(findings: Findings, claim: Claim) -> ClaimRow:
    arms = [arm for arm in findings.study.arms if arm.name in (claim.arm, claim.other)]
    scores = [findings.scores.get(name) for name in (claim.arm, claim.other) if name]
    arm, other = (*scores, None)[:2]
    rule = _rule(claim, arms)
    if arm is None or None in scores:
        return ClaimRow(claim, rule, None, None, 0, NOT_RUN)
    found = stats.judge(claim, arm, other)
    verdict = found.verdict
    if any(len(findings.scores[x.name].seeds) < _planned(x) for x in arms):
        verdict = "not finished"  # stopping as soon as a claim holds would bias the test
    if not np.isfinite(found.number):
        return ClaimRow(claim, rule, None, None, found.seeds, verdict)
    number, interval = _readable(claim, found)
    return ClaimRow(claim, rule, number, interval, found.seeds, verdict)


def _readable(claim: Claim, found: Verdict) -> Estimate:
    """Number and interval of a claim. A spread is judged by its logarithm and shown as a ratio."""
    if claim.measure not in SPREADS:
        return found.number, found.interval
    low, high = np.exp(found.interval).tolist()
    return float(np.exp(found.number)), (low, high)


def _rule(claim: Claim, arms: list[Arm]) -> str:
    """The condition under which a claim holds, such as "final: low-Z augment − raw > 0"."""
    several_panels = len({arm.panel for arm in arms}) > 1
    names = {arm.name: f"{arm.label} ({arm.panel})" if several_panels else arm.label for arm in arms}
    arm, other = (names.get(name, name) for name in (claim.arm, claim.other))
    if claim.measure in SPREADS:
        when = " early" if claim.measure == "early_spread" else ""
        return f"standard deviation{when}: {other} / {arm} > 1"
    number = f"{claim.measure}: {arm}" + (f" − {other}" if other else "")
    if claim.expects == "same":
        return f"{number} within ±{claim.margin:g}"
    return f"{number} > {claim.margin:g}" if claim.expects == "more" else f"{number} < {-claim.margin or 0:g}"


def _planned(arm: Arm) -> int:
    return sum(unit.config.num_seeds for unit in arm.units)


def _embedding(findings: Findings, name: str, unit: FitUnit) -> EmbeddingRow:
    found = findings.fit(unit)
    count = findings.demos(unit.plans).count
    return EmbeddingRow(name, count, unit.config.z_dim, found.seed, found.metrics)


def _demos(findings: Findings, unit: DemosUnit) -> PlansRow:
    found = findings.demos(unit)
    return PlansRow(
        problem=unit.problem_name,
        source=unit.source,
        settings=dict(unit.settings),
        count=found.count,
        reached=found.reached,
        median_duration_s=found.median_duration_s,
        simulated_steps=found.simulated_steps,
    )


def _cost(findings: Findings, arm: Arm) -> CostRow:
    """What an arm takes: its policies, and the units that it needs."""
    needs = {unit.name: unit for unit in all_needs(arm.units)}
    timed = [unit for unit in arm.units if _core_seconds(findings, [unit]) is not None]
    spent, seeds = _core_seconds(findings, timed) or 0.0, sum(unit.config.num_seeds for unit in timed)
    return CostRow(
        panel=arm.panel,
        arm=arm.label,
        steps=arm.units[0].config.steps,
        seed_core_seconds=spent / seeds if seeds else None,
        needs_core_seconds=_core_seconds(findings, needs.values()),
        simulated_steps=_simulated_steps(findings, needs.values()),
    )


def _core_seconds(findings: Findings, units: Iterable[Unit]) -> float | None:
    """The time of some units; None if one of them was not timed."""
    found = [findings.results.get(unit.name) for unit in units]
    timed = [result.core_seconds for result in found if result is not None and not result.resumed]
    return sum(timed) if len(timed) == len(found) else None


def _simulated_steps(findings: Findings, units: Iterable[Unit]) -> int | None:
    """The physics steps of planner and control in some units; None if they were not counted."""
    demos = [unit for unit in units if isinstance(unit, PlansUnit | GuideUnit)]
    if not all(findings.done(unit) for unit in demos):
        return None
    counts = [findings.demos(unit).simulated_steps for unit in demos]
    return None if None in counts else sum(count or 0 for count in counts)


def _time(findings: Findings) -> Time:
    """The time of the finished units, and an estimate for the whole study."""
    timings = Timings.of(findings.study.units, findings.results)
    return Time(
        timed_units=timings.num_timed,
        timed_core_seconds=round(timings.core_seconds),
        whole_core_seconds=round(sum(timings.estimate(unit) for unit in findings.study.units)),
        not_timed=sum(not timings.has_kind(unit) for unit in findings.study.units),
    )
