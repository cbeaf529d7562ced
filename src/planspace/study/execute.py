"""Run one unit: fill its folder, and write the small result that reports are computed from.

    DIR/work/NAME/          the unit's folder, written by `planspace plan`, `embed` or `train`; may be deleted
    DIR/units/NAME.json     the unit's result with a checksum: the unit, its numbers, versions and time

A unit with a result is finished, even if another machine ran it. If its folder is missing, the folder is made
again only when an unfinished unit needs it; the result does not change.
"""

import platform
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from planspace.control.plant import Plant
from planspace.control.runs import DEMOS, control_into
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.embed.training_log import read_log
from planspace.errors import PartialResult, PlanspaceError
from planspace.figures.projection import principal_components
from planspace.physics.step_count import steps_taken
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into, simulated_steps
from planspace.rl.play import play
from planspace.rl.saved_policy import load_policy
from planspace.rl.training import train_policies
from planspace.storage.checks import reject_malformed
from planspace.storage.compiled import use_compilation_cache
from planspace.storage.files import make_folder, write_bytes
from planspace.storage.json_files import read_description, write_sealed
from planspace.storage.provenance import Provenance
from planspace.study.plans_2020 import winding_plans
from planspace.study.results import (
    Film,
    FitResult,
    Found,
    Metrics,
    Paths,
    PlansResult,
    PoliciesResult,
    UnitResult,
    result_from_json,
)
from planspace.study.stick_figure import stick_film
from planspace.study.unit import DemosUnit, FitUnit, GuideUnit, PlansUnit, PolicyUnit, Unit
from planspace.tasks.catalog import find_task
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem
from planspace.workers import CPU_INFO, count_cores

SCHEMA = 1
VERSIONS = Provenance.current("mujoco", "jax").plain()
WHOLE = "unit.whole"
"""File in the folder of a finished unit."""
ITERATIONS_PER_ROW, MIN_ITERATIONS = 5, 50
"""A result stores mean returns of this many iterations, rounded to 2 decimals. A training with fewer than
`MIN_ITERATIONS` iterations stores every iteration."""
LOG_ROWS = 100
"""Maximum number of rows of a training log that a result stores."""
NUM_PATHS, POINTS = 12, 40
"""Maximum numbers of demonstrations in z that a result stores, and of states per demonstration."""
FILM_SEED = 1000
"""Seed of the start state of the episode that a result stores."""


def folder_of(unit: Unit, out: Path) -> Path:
    """The folder of a unit."""
    return out / "work" / unit.name


def result_file(unit: Unit, out: Path) -> Path:
    """The file of a unit's result."""
    return out / "units" / f"{unit.name}.json"


def is_done(unit: Unit, out: Path) -> bool:
    """Whether the unit has a result."""
    return result_file(unit, out).exists()


def has_folder(unit: Unit, out: Path) -> bool:
    """Whether the unit's folder is complete."""
    return (folder_of(unit, out) / WHOLE).exists()


def read_result(unit: Unit, out: Path) -> UnitResult:
    """Read the result of a finished unit.

    Raises:
        PlanspaceError: the file is damaged, or was written by a newer planspace.
    """
    return read_result_file(result_file(unit, out), unit.kind)


def read_result_file(file: Path, kind: str) -> UnitResult:
    """Read a result from its file.

    Args:
        file: `DIR/units/NAME.json`.
        kind: the kind of unit: `plans`, `fit`, `guide` or `policies`.

    Raises:
        PlanspaceError: the file is damaged, or was written by a newer planspace.
    """
    data = read_description(file, kind=f"{kind} of a study", schema=SCHEMA)
    with reject_malformed(file):
        return result_from_json(kind, data)


def execute(unit: Unit, out: Path) -> None:
    """Run a unit, or resume it, and write its result.

    Args:
        unit: the unit. The units that it needs have their folders.
        out: the folder of the studies.

    Raises:
        PlanspaceError: the unit failed. Finished work is saved.
    """
    use_compilation_cache()
    start = time.monotonic()
    folder = folder_of(unit, out)
    resumed = folder.exists()
    make_folder(folder.parent)
    found = _RUN[unit.kind](unit, folder, out)
    seconds = round(time.monotonic() - start, 1)
    keep_result(unit, out, UnitResult(found, seconds, count_cores(), resumed, cpu_model()))
    write_bytes(folder / WHOLE, b"")


def keep_result(unit: Unit, out: Path, result: UnitResult) -> None:
    """Write the result of a unit. If only the unit's folder was made again, keep the existing result.

    Raises:
        PlanspaceError: the new folder differs from the existing result, which other units depend on.
    """
    if not is_done(unit, out):
        make_folder(result_file(unit, out).parent)
        data = {
            "schema": SCHEMA,
            "kind": f"{unit.kind} of a study",
            "unit": unit.spec,
            "versions": VERSIONS,
            **asdict(result),
        }
        write_sealed(result_file(unit, out), data, indent=None)
        return
    before, now = (getattr(x.found, "hash", "") for x in (read_result(unit, out), result))
    if before != now:
        raise PlanspaceError(
            f"{unit.name} was run again and gave a different result, because this machine or its libraries "
            f"round differently from the machine that made {result_file(unit, out).parent}. Copy the folder "
            f"{folder_of(unit, out)} from that machine, or choose another --out."
        )


def _run_plans(unit: PlansUnit, folder: Path, out: Path) -> PlansResult:
    problem = load_problem(unit.problem)
    if unit.source == "2020":
        winding_plans(problem, folder, unit.num, unit.seed)
    else:
        config = PlanConfig.for_problem(problem, **dict(unit.settings))
        with suppress(PartialResult):  # use the plans that were found
            plan_into(problem, folder, num=unit.num, seed=unit.seed, config=config, workers=0)
    demos = load_demos(folder)
    return PlansResult(
        count=len(demos),
        median_duration_s=float(np.median(demos.times[demos.offsets[1:] - 1])),
        reached=_fraction_at_goal(demos, problem),
        hash=demos.hash,
        simulated_steps=simulated_steps(folder) if unit.source == "plan" else None,
    )


def _run_guide(unit: GuideUnit, folder: Path, out: Path) -> PlansResult:
    embedding, plans = load_embedding(folder_of(unit.fit, out)), load_demos(folder_of(unit.plans, out))
    before, resumed = steps_taken(), folder.exists()
    summary = control_into(
        Plant.find(unit.task),
        embedding,
        unit.config,
        folder,
        num=unit.num,
        seed=unit.seed,
        workers=0,
        plans=plans,
    )
    if not summary.success:
        raise PlanspaceError(f"control of {unit.problem_name} held the goal in none of {unit.num} episodes.")
    demos = load_demos(_demos_folder(unit, out))
    return PlansResult(
        count=len(demos),
        median_duration_s=float(np.median(demos.times[demos.offsets[1:] - 1])),
        reached=len(demos) / unit.num,
        hash=demos.hash,
        simulated_steps=None if resumed else steps_taken() - before,
    )


def _demos_folder(unit: DemosUnit, out: Path) -> Path:
    """The dataset in the folder of a unit."""
    return folder_of(unit, out) / DEMOS if isinstance(unit, GuideUnit) else folder_of(unit, out)


def _fraction_at_goal(demos: Demos, problem: Problem) -> float:
    """The fraction of demonstrations that end within the tolerance of their goal."""
    _, space = demos.info.compile()
    outside = np.abs(space.difference(demos.states[demos.offsets[1:] - 1], demos.goals))
    if not problem.goal_random:
        outside = np.maximum(outside - problem.draw_goal(space, np.random.default_rng(0)).half, 0.0)
    distances = np.sum(outside * problem.weights_to_goal(space), axis=-1)
    return float(np.mean(distances <= problem.tolerance))


def _run_fit(unit: FitUnit, folder: Path, out: Path) -> FitResult:
    demos = load_demos(folder_of(unit.plans, out))
    embedding = fit_embedding(
        demos, config=unit.config, out=folder, num_seeds=unit.num_seeds, seed=unit.seed, split_seed=0
    )
    about = embedding.require_about()
    found = FitResult(
        seed=about.seed,
        metrics=_rounded(about.metrics["test"]),
        raw_state=_rounded(about.metrics_raw_state),
        paths=_paths(embedding, demos),
        hash=embedding.hash,
    )
    if about.objective is not None and about.objective.closed_form:
        return found  # there is no training log
    rows = [row for row in read_log(folder) if "path_error" in row]
    rows = [rows[i] for i in sorted({round(x) for x in np.linspace(0, len(rows) - 1, LOG_ROWS)})]
    path_error, bound = (tuple(_round_all(row[name], 4) for row in rows) for name in ("path_error", "bound"))
    return replace(found, log_steps=tuple(row["step"] for row in rows), path_error=path_error, bound=bound)


def _run_policies(unit: PolicyUnit, folder: Path, out: Path) -> PoliciesResult:
    embeddings = [load_embedding(folder_of(fit, out)) for fit in unit.fits]
    task = find_task(unit.task)
    plans = None if unit.demos is None else load_demos(_demos_folder(unit.demos, out))
    history = train_policies(task, unit.config, embedding=embeddings, plans=plans, out=folder).history
    returns, steps = history["return"], history["steps"]
    every = ITERATIONS_PER_ROW if len(returns) >= MIN_ITERATIONS else 1
    stops = [*range(every, len(returns), every), len(returns)]
    blocks = [returns[a:b].mean(axis=0) for a, b in zip([0, *stops[:-1]], stops, strict=True)]
    best = load_policy(folder)
    _, played = play(best, 1, FILM_SEED, task)
    film = stick_film(played)
    return PoliciesResult(
        seeds=tuple(unit.config.seeds),
        steps=tuple(int(steps[stop - 1]) for stop in stops),
        returns=tuple(_round_all(blocks, 2)),
        frozen=tuple(history["frozen"][-1].astype(bool).tolist()),
        eval_steps=tuple(history["eval_steps"].tolist()),
        eval_returns=tuple(_round_all(history["eval_return"], 2)),
        embeddings=tuple(embedding.hash for embedding in embeddings),
        film=None if film is None else Film(best.seed, film.seconds, film.poses),
    )


def cpu_model() -> str:
    """The model of this machine's CPU, or its architecture if the system does not say."""
    lines = CPU_INFO.read_text().splitlines() if CPU_INFO.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _paths(embedding: Embedding, demos: Demos) -> Paths:
    """Project test demonstrations onto three principal components of z."""
    used = demos.select(embedding.inputs.names)
    test = embedding.require_about().split["test"][:NUM_PATHS]
    rows = [used.offsets[i] + _spread_rows(int(used.offsets[i + 1] - used.offsets[i])) for i in test]
    z = [embedding.encode(used.states[part]) for part in rows]
    flat, _ = principal_components(np.concatenate(z), min(3, embedding.z_dim))
    parts = np.split(flat, np.cumsum([len(part) for part in z])[:-1])
    return tuple(_round_all(part, 3) for part in parts)


def _spread_rows(num: int) -> np.ndarray:
    """Indices of at most `POINTS` evenly spaced rows out of `num`."""
    return np.unique(np.linspace(0, num - 1, POINTS).round().astype(int))


def _rounded(metrics: Metrics) -> Metrics:
    return {k: _round_all(v, 4) if isinstance(v, float) else v for k, v in metrics.items()}


def _round_all(numbers: Any, decimals: int) -> Any:
    """Round numbers for JSON; None for a number that is missing or not finite."""
    if isinstance(numbers, list | tuple | np.ndarray):
        return [_round_all(x, decimals) for x in numbers]
    return None if numbers is None or not np.isfinite(numbers) else round(float(numbers), decimals)


_RUN: dict[str, Callable[[Any, Path, Path], Found]] = {
    PlansUnit.kind: _run_plans,
    FitUnit.kind: _run_fit,
    GuideUnit.kind: _run_guide,
    PolicyUnit.kind: _run_policies,
}
