"""Planning many demonstrations: in memory, or in a dataset folder that an interrupted command continues."""

import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.folder import LOG, DemoFolder
from planspace.demos.load import load_demos
from planspace.demos.manifest import DatasetSettings
from planspace.demos.state_info import StateInfo
from planspace.errors import PartialResult, UsageError, check_whole
from planspace.physics.simulator import Simulator
from planspace.plan.config import PlanConfig, PolishConfig, RegulatorConfig, find_planner
from planspace.plan.durations import in_seconds
from planspace.plan.metric import Metric, describe_metric
from planspace.plan.pipeline import MAX_ATTEMPTS, Pipeline
from planspace.plan.planner import Failure, check_problem
from planspace.plan.planners import PLANNERS
from planspace.plan.sst import SST
from planspace.plan.workers import Planned, check_workers, plan_all
from planspace.progress import progress, progress_shown
from planspace.seams import name_of, plain_settings
from planspace.storage.checks import reject_malformed
from planspace.storage.provenance import Provenance
from planspace.storage.rows import append_rows, read_rows
from planspace.storage.runs import lock_folder
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem

SHARD_EPISODES = 10
"""Plans per shard. A kill loses those since the last shard, Ctrl-C those after the first unfinished plan."""
STEPS = "simulated_steps"
"""What the log calls the physics steps that planning took, see `Planned`; null if they were not counted."""
TREE_SETTINGS = ("keep_trees", "tree_nodes")


def plan_demos(  # noqa: PLR0913
    problem: Problem | str,
    num: int = 100,
    *,
    planner: Any = None,
    config: PlanConfig | None = None,
    metric: Metric | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    workers: int | None = None,
    verbose: bool = True,
) -> Demos:
    """Plan demonstrations from random starts.

    Every plan depends only on the problem, the settings, the seed and the plan's number. If some plans are
    not found, the others are returned, with a warning.

    Args:
        problem: a problem, a shipped problem's name, or a problem file.
        num: number of plans.
        planner: a name in `PLANNERS`, an object that fits the protocol `Planner`, or a function
            `plan(query, rng)`. By default that of `config`, or the problem's own.
        config: settings of planner, polish and regulator; by default the problem's own.
        metric: how far states are from a goal, for example `embedding.time_to_go` of an embedding of such
            states; the search extends the nodes nearest to the goal more often. By default that of `config`.
        out: a dataset folder. The plans that it already holds are kept. By default the plans are only
            returned.
        seed: seed of all starts, goals and searches.
        workers: number of processes; by default one for each CPU. 0 plans in this process; its results may
            differ in their last bits.
        verbose: show a progress bar.

    Returns:
        The demonstrations.

    Raises:
        UsageError: the planner does not fit the protocol `Planner`, or cannot plan this problem.
        PlanspaceError: `out` cannot be written or holds something else, or the problem has no valid start.
        PartialResult: no plan at all was found.
    """
    check_whole("num", num)
    check_whole("seed", seed, 0)
    problem = load_problem(problem)
    if config is None:
        config = PlanConfig.for_problem(problem, planner=planner)
    elif planner is not None:
        config = replace(config, planner=find_planner(planner))
    if metric is not None:
        config = replace(config, metric=metric)
    with tempfile.TemporaryDirectory() as temporary, progress_shown(verbose):
        folder = _plan_missing(problem, Path(temporary if out is None else out), num, seed, config, workers)
        report = _report_failures(folder)
        if report and not folder.num_episodes:
            raise PartialResult(report)
        if report:
            warnings.warn(report, stacklevel=2)
        return load_demos(folder.path)


def plan_into(
    problem: Problem,
    out: Path,
    *,
    num: int,
    seed: int,
    config: PlanConfig | None = None,
    workers: int | None = None,
) -> DemoFolder:
    """Plan demonstrations from random starts into a dataset folder.

    The plans that the folder already holds are kept. Plan i depends only on the problem, the settings, the
    seed and i, so an interrupted command ends with the same content as one that was not interrupted.

    Args:
        problem: what to plan.
        out: the dataset folder.
        num: number of plans that the folder will hold.
        seed: seed of all starts, goals and searches.
        config: settings of planner, polish and regulator; by default the problem's own.
        workers: number of processes; by default one for each CPU. 0 plans in this process, where linear
            algebra may use several threads and other kernels, and may round differently.

    Returns:
        The folder.

    Raises:
        UsageError: the planner does not fit the protocol `Planner`, or cannot plan this problem.
        PlanspaceError: the folder cannot be written or holds something else, or the problem has no valid
            start.
        PartialResult: some plans failed at every attempt; the others are saved.
    """
    config = config or PlanConfig.for_problem(problem)
    folder = _plan_missing(problem, out, num, seed, config, workers)
    if report := _report_failures(folder):
        saved = f" The other {folder.num_episodes} are saved in {folder.path}." if folder.num_episodes else ""
        raise PartialResult(report + saved)
    return folder


def state_info(problem: Problem) -> StateInfo:
    """Names, units and model of the states of a problem's demonstrations."""
    model, space = problem.compile()
    return StateInfo.of_model(
        model, space, problem=problem.name, joints=problem.joints, source=problem.source
    )


def _settings(problem: Problem, config: PlanConfig, seed: int) -> DatasetSettings:
    """What decides the content of a dataset, as the manifest records it."""
    plain = plain_settings(replace(config, restarts=config.num_searches, metric=None))
    if not config.keep_trees:  # then the manifest is what versions without search trees wrote
        plain = {name: value for name, value in plain.items() if name not in TREE_SETTINGS}
    if config.metric is not None:
        plain["metric"] = describe_metric(config.metric)
    return {
        "problem": problem.hash,
        "seed": seed,
        "planner": name_of(config.planner),
        "config": plain,
        "versions": Provenance.current("mujoco").plain(),
    }


def upgrade_settings(settings: DatasetSettings, time_step: float) -> DatasetSettings:
    """A manifest's settings as this version writes them.

    Settings that an earlier version did not have get their defaults. Version 0.1.0 recorded the settings of
    all planners, used or not: `config.sst` and `config.ompl`, and durations in physics steps.

    Args:
        settings: the settings of the manifest.
        time_step: the model's time step [s].
    """
    config, name = settings.get("config"), settings.get("planner")
    if not isinstance(config, dict) or not isinstance(name, str) or name not in PLANNERS:
        return settings
    group = name.partition("-")[0]
    own = config.get(group, config.get("planner"))
    if not isinstance(own, dict):
        return settings
    parts = {"planner": own, "polish": config.get("polish"), "regulator": config.get("regulator")}
    defaults = {"planner": PLANNERS[name], "polish": PolishConfig(), "regulator": RegulatorConfig()}
    current = {
        part: plain_settings(defaults[part]) | in_seconds(saved or {}, time_step)
        for part, saved in parts.items()
    }
    current["restarts"] = config.get("restarts") if group == SST.name or group not in config else 1
    current |= {name: config[name] for name in (*TREE_SETTINGS, "metric") if name in config}
    return settings | DatasetSettings(config=current)


def _plan_missing(
    problem: Problem, out: Path, num: int, seed: int, config: PlanConfig, workers: int | None
) -> DemoFolder:
    """Plan the demonstrations that a folder does not hold yet."""
    _check_predicate(problem)
    check_problem(config.planner, problem)
    _check_start(problem)
    check_workers(problem, config, workers)
    info, settings = state_info(problem), _settings(problem, config, seed)
    with lock_folder(out):
        upgrade = partial(upgrade_settings, time_step=problem.compile()[0].opt.timestep)
        folder = DemoFolder(out, info, settings, upgrade=upgrade)
        remaining = range(folder.next_index, num)
        if remaining:
            _warn_of_unrest(problem, config)
            with closing(plan_all(problem, config, seed, remaining, workers)) as plans:  # kills the workers
                _extend(folder, remaining, plans)
    return folder


def _warn_of_unrest(problem: Problem, config: PlanConfig) -> None:
    """Warn before a long search if the regulator does not hold the goal itself."""
    if unrest := Pipeline(problem, config).describe_unrest():
        warnings.warn(
            f"problem {problem.name}: the regulator does not hold the robot at the goal: {unrest}. If no "
            "plan is found, give a goal at which the robot can rest, or `hold: false`.",
            stacklevel=4,
        )


def _extend(folder: DemoFolder, remaining: range, plans: Iterator[Planned]) -> None:
    """Save plans as they are made; after an error or Ctrl-C, those that are finished."""
    batch, failures, steps, solved, next_index = [], [], [], 0, remaining.start

    def save() -> None:
        row = {"time": time.time(), "planned": next_index, "failures": list(failures)}
        row[STEPS] = None if None in steps else sum(steps)
        append_rows(folder.path / LOG, [row], key="planned")  # before the shard, so that no row is missing
        folder.append(batch, next_index)
        batch.clear()
        failures.clear()
        steps.clear()

    began = time.monotonic()
    with progress("plan", remaining.stop, done=remaining.start, unit="plan") as bar:
        try:
            for i, (plan, plan_steps) in zip(remaining, plans, strict=True):
                steps.append(plan_steps)
                if isinstance(plan, Episode):
                    batch.append(plan)
                    solved += 1
                else:
                    failures.append(_failure_row(i, plan))
                next_index = i + 1
                tried, minutes = next_index - remaining.start, (time.monotonic() - began) / 60
                bar.set_postfix_str(
                    f"{solved} of {tried} solved, {solved / minutes:.0f} per minute", refresh=False
                )
                bar.update()
                if next_index % SHARD_EPISODES == 0:
                    save()
        finally:
            if next_index > folder.next_index:
                save()


def _failure_row(index: int, failure: Failure) -> dict[str, Any]:
    nearest = failure.nearest if np.isfinite(failure.nearest) else None
    return {"plan": index, "nearest": nearest, "reason": failure.reason}


def simulated_steps(folder: Path) -> int | None:
    """The physics steps that the plans of a folder took; None if they were not counted, see `Planned`.

    Raises:
        PlanspaceError: the log is missing or damaged.
    """
    with reject_malformed(folder / LOG):
        rows = read_rows(folder / LOG)
        counts = [row[STEPS] for row in rows if row.get(STEPS) is not None]
        return sum(counts) if len(counts) == len(rows) else None


def _report_failures(folder: DemoFolder) -> str:
    """How many plans failed and which came nearest to its goal; empty if none failed."""
    missing = folder.next_index - folder.num_episodes
    if not missing:
        return ""
    with reject_malformed(folder.path / LOG):
        failures = [failure for row in read_rows(folder.path / LOG) for failure in row["failures"]]
        near = [failure for failure in failures if failure["nearest"] is not None]
        closest = min(near, key=lambda failure: failure["nearest"], default=None)
        where = (
            f" The nearest came within {closest['nearest']:.3g} of it ({closest['reason']})."
            if closest
            else ""
        )
    return (
        f"{missing} of {folder.next_index} plans found no way to the goal in {MAX_ATTEMPTS} attempts.{where}"
    )


def _check_predicate(problem: Problem) -> None:
    """Refuse a predicate without a name: worker processes import it, and the dataset records its name."""
    name = getattr(problem.predicate, "__qualname__", "<none>")
    if problem.predicate is not None and ("<" in name or not hasattr(problem.predicate, "__module__")):
        raise UsageError("the predicate must be a function that its module has by name, not a lambda.")


def _check_start(problem: Problem) -> None:
    """Refuse a problem without a valid start before anything is written."""
    model, space = problem.compile()
    simulator = Simulator(model, space, 1, threads=1, validity=problem.validity)
    problem.draw_start(simulator, np.random.default_rng(0))
