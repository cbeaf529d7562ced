"""The results of a study as one tidy table: `results.csv`, with one number per row.

Columns: `study`, `arm`, `seed`, `embedding`, `step`, `metric`, `value`, and `command` and `cpu` for timings.
Cells that do not apply are empty. The tables, claims and curves of a study can be computed from its
`results.csv`. Demonstrations in z and films are stored only in the units.

| metric | columns used | value |
|---|---|---|
| `return` | seed, step | mean return since the previous row's step, or of evaluations in some studies |
| `final_return`, `early_return`, `whole_return` | seed | mean return: end, first quarter, all |
| `steps_to_solved` | seed | environment steps until the task is solved; no row if never |
| `evaluation_return` | seed | mean return of the last evaluation |
| `diverged` | seed | 1; no row if the seed did not diverge |
| `training_path_error`, `training_bound` | seed, embedding, step | during the training of the embedding |
| `straightness`, ... | seed, embedding | geometry on test demonstrations; the seed is the selected one |
| `plans_count`, `plans_reached`, `plans_median_duration_s`, `plans_simulated_steps` | embedding | \
its demonstrations; without an embedding those that policies or a guide use |
| `guide_count`, ... | | the episodes of a guide |
| `..._core_seconds` | | time of a unit: of plans, of an embedding, of policies of five seeds |
"""

import csv
import io
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from planspace.errors import PlanspaceError
from planspace.storage.checks import reject_malformed
from planspace.storage.files import read_bytes, write_bytes
from planspace.study import stats
from planspace.study.design import Arm, Study, solved_level
from planspace.study.findings import Findings
from planspace.study.results import FitResult, PlansResult, PoliciesResult, UnitResult
from planspace.study.stats import Reached, Scores
from planspace.study.unit import DemosUnit, FitUnit, GuideUnit, PlansUnit, Unit

FILE = "results.csv"
POINTS = 25
"""Number of points of a stored learning curve. The tables are computed from the full curve."""
LOG_POINTS = 20
"""Number of points of a stored training curve of an embedding. Each is a mean of neighbouring rows."""
PLANS_TIME, GUIDE_TIME = "plans_core_seconds", "guide_core_seconds"
FIT_TIME, POLICIES_TIME = "embedding_core_seconds", "policies_core_seconds"
TRAINING = {"path_error": "training_path_error", "bound": "training_bound"}
PLANS_METRICS = ("count", "reached", "median_duration_s", "simulated_steps")


class Row(NamedTuple):
    """A row of the table; None is an empty cell."""

    study: str
    arm: str
    seed: int | None
    embedding: int | None
    """Index of the embedding among those that the seeds of the arm use in turn."""
    step: int | None
    metric: str
    value: float
    command: str = ""
    cpu: str = ""


def write_tidy(findings: Findings, path: Path, points: Mapping[str, int] | None = None) -> None:
    """Write the table of a study.

    Args:
        findings: the results of the study so far.
        path: the file.
        points: number of points of each stored learning curve, by panel; `POINTS` if not given.
    """
    write_rows(_rows(findings, points or {}), path)


def write_rows(rows: Iterable[Row], path: Path) -> None:
    """Write a table."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row._fields)
    for row in rows:
        cells = row._asdict() | {"value": _number(float(row.value))}
        writer.writerow("" if cell is None else cell for cell in cells.values())
    write_bytes(path, text.getvalue().encode())


def read_rows(path: Path) -> list[Row]:
    """Read a table.

    Raises:
        PlanspaceError: the file is missing, or is not a table of results.
    """
    with reject_malformed(path):
        lines = csv.reader(io.StringIO(read_bytes(path).decode()))
        if tuple(next(lines)) != Row._fields:
            raise PlanspaceError(f"{path} is not a table of results: its columns must be {Row._fields}.")
        return [
            Row(study, arm, _whole(seed), _whole(embedding), _whole(step), metric, float(value), *timing)
            for study, arm, seed, embedding, step, metric, value, *timing in lines
        ]


def read_tidy(study: Study, path: Path, versions: Mapping[str, str]) -> Findings:
    """Read the findings of a study from its table.

    Args:
        study: the study, which may have only some of its arms.
        path: the file.
        versions: library versions that the units were run with.

    Raises:
        PlanspaceError: the file is missing, or is not a table of results.
    """
    by_arm: defaultdict[str, list[Row]] = defaultdict(list)
    for row in read_rows(path):
        by_arm[row.arm].append(row)
    with reject_malformed(path):
        found = {arm.name: _scores(arm, rows) for arm in study.arms if (rows := by_arm.get(arm.name))}
        scores = {name: x for name, x in found.items() if x.seeds}
        results: dict[str, UnitResult] = {}
        for arm in study.arms:
            results = dict(_unit_results(arm, by_arm[arm.name], scores.get(arm.name))) | results
    return Findings(study, results, scores, versions)


# --- writing --------------------------------------------------------------------------------------------


def _rows(findings: Findings, points: Mapping[str, int]) -> Iterator[Row]:
    written: set[str] = set()
    for arm in findings.study.arms:
        for metric, index, unit in _needs(arm):
            if unit.name not in written and findings.done(unit):
                written.add(unit.name)
                head = Row(findings.study.name, arm.name, None, index, None, metric, 0.0)
                yield from (
                    _fit_rows(head, findings, unit)
                    if isinstance(unit, FitUnit)
                    else _demos_rows(head, findings, unit)
                )
                yield from _time_rows(head, findings, unit)
        if scores := findings.scores.get(arm.name):
            yield from _policy_rows(findings.study.name, arm, scores, points.get(arm.panel, POINTS))
        for unit in arm.units:
            if unit.name not in written and findings.done(unit):
                written.add(unit.name)
                head = Row(findings.study.name, arm.name, unit.config.seed, None, None, POLICIES_TIME, 0.0)
                yield from _time_rows(head, findings, unit)


def _needs(arm: Arm) -> Iterator[tuple[str, int | None, DemosUnit | FitUnit]]:
    """The units that an arm's policies need: metric of the time, index of the embedding, unit.

    The embedding of a guide follows those of z. Demonstrations that policies or a guide use have no index.
    """
    unit = arm.units[0]
    guide = unit.demos if isinstance(unit.demos, GuideUnit) else None
    for index, fit in enumerate(unit.fits if guide is None else (*unit.fits, guide.fit)):
        yield PLANS_TIME, index, fit.plans
        yield FIT_TIME, index, fit
    if isinstance(unit.demos, PlansUnit):
        yield PLANS_TIME, None, unit.demos
    if guide is not None:
        yield PLANS_TIME, None, guide.plans
        yield GUIDE_TIME, None, guide


def _policy_rows(study: str, arm: Arm, scores: Scores, points: int) -> Iterator[Row]:
    level = solved_level(arm)
    never = np.full(len(scores.seeds), np.inf)
    of_seeds = {
        "final_return": stats.final(scores),
        "early_return": stats.early(scores),
        "whole_return": stats.whole(scores),
        "steps_to_solved": never if level is None else stats.steps_to(scores, level),
        "evaluation_return": never if scores.evaluation is None else scores.evaluation,
    }
    end = int(scores.steps[-1])
    of_embedding = [seed % arm.num_embeddings if arm.num_embeddings else None for seed in scores.seeds]
    for seed, embedding, frozen in zip(scores.seeds, of_embedding, scores.diverged, strict=True):
        if frozen:
            yield Row(study, arm.name, seed, embedding, end, "diverged", 1.0)
    for metric, values in of_seeds.items():
        for seed, embedding, value in zip(scores.seeds, of_embedding, values, strict=True):
            if np.isfinite(value):
                yield Row(study, arm.name, seed, embedding, end, metric, float(value))
    for step, returns in _thinned(scores, points):
        for seed, embedding, value in zip(scores.seeds, of_embedding, returns, strict=True):
            yield Row(study, arm.name, seed, embedding, step, "return", float(f"{value:.4g}"))


def _thinned(scores: Scores, points: int) -> Iterator[tuple[int, np.ndarray]]:
    """About `points` points of the learning curves: the step, and each seed's mean return up to it."""
    every = max(1, -(-len(scores.steps) // points))
    lengths = np.diff(scores.steps, prepend=0)
    for start in range(0, len(scores.steps), every):
        part = slice(start, start + every)
        yield int(scores.steps[part][-1]), np.average(scores.returns[part], axis=0, weights=lengths[part])


def _fit_rows(head: Row, findings: Findings, unit: FitUnit) -> Iterator[Row]:
    found = findings.fit(unit)
    for metric, value in found.metrics.items():
        if value is not None:
            yield head._replace(seed=found.seed, metric=metric, value=value)
    if unit.num_seeds < 2 or not found.log_steps:
        return
    blocks = np.array_split(np.arange(len(found.log_steps)), min(LOG_POINTS, len(found.log_steps)))
    for name, metric in TRAINING.items():
        values = np.array(getattr(found, name), dtype=float)
        for block in blocks:
            step = found.log_steps[block[-1]]
            for k, value in enumerate(values[block].mean(axis=0)):
                if np.isfinite(value):
                    row = head._replace(seed=unit.seed + k, step=step, metric=metric)
                    yield row._replace(value=round(float(value), 5))


def _demos_rows(head: Row, findings: Findings, unit: DemosUnit) -> Iterator[Row]:
    found = findings.demos(unit)
    for name in PLANS_METRICS:
        if (value := getattr(found, name)) is not None:
            yield head._replace(metric=f"{unit.kind}_{name}", value=value)


def _time_rows(head: Row, findings: Findings, unit: Unit) -> Iterator[Row]:
    result = findings.results[unit.name]
    if not result.resumed:
        yield head._replace(value=result.core_seconds, command=findings.study.command, cpu=result.cpu)


def _number(value: float) -> str:
    """Format a number with at most six decimals, without trailing zeros: 12, -236.41."""
    return np.format_float_positional(round(value, 6) + 0.0, trim="-")


# --- reading --------------------------------------------------------------------------------------------


def _scores(arm: Arm, rows: Sequence[Row]) -> Scores:
    values: defaultdict[str, dict[int, float]] = defaultdict(dict)
    curve: defaultdict[int, dict[int, float]] = defaultdict(dict)
    for row in rows:
        if row.metric == "return" and row.step is not None and row.seed is not None:
            curve[row.step][row.seed] = row.value
        elif row.seed is not None:
            values[row.metric][row.seed] = row.value
    planned = {seed for unit in arm.units for seed in unit.config.seeds}
    seeds = tuple(seed for seed in values["final_return"] if seed in planned)

    def of_seeds(metric: str, missing: float = np.nan) -> np.ndarray:
        return np.array([values[metric].get(seed, missing) for seed in seeds])

    return Scores(
        seeds,
        np.array(sorted(curve)),
        np.array([[curve[step][seed] for seed in seeds] for step in sorted(curve)]),
        arm.num_embeddings,
        tuple(bool(x) for x in of_seeds("diverged", 0.0)),
        of_seeds("evaluation_return"),
        Reached(
            of_seeds("final_return"),
            of_seeds("early_return"),
            of_seeds("whole_return"),
            of_seeds("steps_to_solved", np.inf),
        ),
    )


def _unit_results(arm: Arm, rows: Sequence[Row], scores: Scores | None) -> Iterator[tuple[str, UnitResult]]:
    times = {
        (row.metric, row.embedding, row.seed): row for row in rows if row.metric.endswith("_core_seconds")
    }
    for metric, index, unit in _needs(arm):
        own = [row for row in rows if row.embedding == index]
        if isinstance(unit, FitUnit):
            found = _fit_result(unit, [row for row in own if not row.metric.startswith("plans_")])
        else:
            found = _demos_result(unit.kind, own)
        if found is not None:
            yield unit.name, _timed(found, times.get((metric, index, None)))
    seeds = scores.seeds if scores else ()
    for unit in arm.units:
        if set(unit.config.seeds) <= set(seeds):
            found = PoliciesResult(tuple(unit.config.seeds), (), (), ())
            yield unit.name, _timed(found, times.get((POLICIES_TIME, None, unit.config.seed)))


def _timed(found: PlansResult | FitResult | PoliciesResult, time: Row | None) -> UnitResult:
    if time is None:
        return UnitResult(found, 0.0, 1, resumed=True)
    return UnitResult(found, time.value, 1, cpu=time.cpu)


def _fit_result(unit: FitUnit, rows: Sequence[Row]) -> FitResult | None:
    metrics = [row for row in rows if row.seed is not None and row.step is None]
    if not metrics:
        return None
    curves: dict[str, tuple[list[float | None], ...]] = {}
    steps: list[int] = []
    for name, metric in TRAINING.items():
        values = {(row.step, row.seed): row.value for row in rows if row.metric == metric}
        steps = sorted({step for step, _ in values if step is not None})
        seeds = range(unit.seed, unit.seed + unit.num_seeds)
        curves[name] = tuple([values.get((step, seed)) for seed in seeds] for step in steps)
    return FitResult(
        seed=metrics[0].seed or 0,
        metrics={row.metric: row.value for row in metrics},
        log_steps=tuple(steps),
        path_error=curves["path_error"],
        bound=curves["bound"],
    )


def _demos_result(kind: str, rows: Sequence[Row]) -> PlansResult | None:
    own = [row for row in rows if row.metric.startswith(f"{kind}_")]
    found = {row.metric.removeprefix(f"{kind}_"): row.value for row in own}
    if "count" not in found:
        return None
    steps = found.get("simulated_steps")
    return PlansResult(
        count=int(found["count"]),
        reached=found["reached"],
        median_duration_s=found["median_duration_s"],
        simulated_steps=None if steps is None else int(steps),
    )


def _whole(text: str) -> int | None:
    return int(text) if text else None
