"""`planspace run`: plan, embed, control in plan space, and train policies on request, in one command."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import planspace
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.fit import fit_embedding
from planspace.errors import PartialResult, PlanspaceError, unknown
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.plan.sst import SST
from planspace.storage.checks import CONFIG
from planspace.storage.json_files import read_json, write_json
from planspace.storage.runs import lock_folder, open_run
from planspace.study.budgets import BUDGETS, Budget, BudgetName
from planspace.study.quickstart_report import write_report
from planspace.study.run_control import control_stage
from planspace.study.run_policies import TRAIN, train_arms, verdicts
from planspace.study.run_summary import ArmReturns, DemosSummary, GeometrySummary, RunSummary, as_json
from planspace.tasks.catalog import find_task
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem
from planspace.tasks.stored_task import save_task, stored_task, task_content
from planspace.tasks.task import Task
from planspace.tasks.task_hash import with_todays_hash


def run(
    given: str | Path | Task, budget_name: BudgetName, out: Path, seed: int, *, train: bool = False
) -> RunSummary:
    """Plan, embed, control and report. Finished stages are kept, and an interrupted stage is resumed.

    Args:
        given: a task's command-line name, the path of a problem file, or a task with a planning problem.
        budget_name: a key of `BUDGETS`.
        out: the run's folder.
        seed: the seed of every stage.
        train: also train policies with and without z. A folder that has policies keeps them.

    Returns:
        The summary that `summary.json` holds.

    Raises:
        PlanspaceError: a stage failed. Earlier work is saved.
    """
    task = find_task(given)  # refuses an unknown name before anything is written
    if budget_name not in BUDGETS:
        raise unknown("budget", budget_name, BUDGETS)
    with lock_folder(out):
        config = _config(task, budget_name, BUDGETS[budget_name], seed)
        open_run(out, config, update=partial(with_todays_hash, task=task))
        save_task(task, out)
        return _run_stages(task, budget_name, out, seed, train or (out / TRAIN).exists())


def _run_stages(task: Task, budget_name: BudgetName, out: Path, seed: int, train: bool) -> RunSummary:
    budget = BUDGETS[budget_name]
    problem = load_problem(task.problem)
    demos, unsolved = _plan(problem, out / "demos", budget, seed)
    embedding = fit_embedding(
        demos, config=budget.fit, out=out / "embedding", num_seeds=budget.embedding_seeds, seed=seed
    )
    control = control_stage(task, embedding, out, budget.control, seed)
    policies = train_arms(task, embedding, out, budget, seed) if train else None
    histories = {} if policies is None else policies.histories
    summary = RunSummary(
        control=control,
        task=task.name,
        budget=budget_name,
        seed=seed,
        version=planspace.__version__,
        demos=DemosSummary.of(demos),
        geometry=GeometrySummary.of(embedding.require_about()),
        arms={label: ArmReturns.of(history) for label, history in histories.items()},
        diverged=() if policies is None else policies.diverged,
        verdicts=verdicts(histories),
        unsolved=unsolved,
    )
    write_json(out / "summary.json", as_json(summary))
    write_report(out, summary, task, demos, embedding, policies)
    return summary


def _plan(problem: Problem, out: Path, budget: Budget, seed: int) -> tuple[Demos, str]:
    """The demonstrations, and the message about those that were not found; a run goes on without them."""
    try:
        plan_into(problem, out, num=budget.demos, seed=seed, config=_planner(problem, budget))
    except PartialResult as partial:
        try:
            return load_demos(out), str(partial)
        except PlanspaceError:  # none was found
            raise partial from None
    return load_demos(out), ""


def _planner(problem: Problem, budget: Budget) -> PlanConfig:
    """The planner of the budget; that of the problem if it has settings of its own."""
    if problem.planner == SST.name and not problem.settings:
        return budget.planner
    return PlanConfig.for_problem(problem, restarts=budget.planner.restarts)


def rebuild(out: Path) -> RunSummary:
    """Write the report of a run again, from its folder.

    Raises:
        PlanspaceError: the folder is not a run, its `config.json` is incomplete, or `run` fails.
    """
    config = read_json(out / CONFIG) if (out / CONFIG).exists() else {}
    if config.get("command") != "run":
        what = "is not the folder of a `planspace run`" if out.exists() else "does not exist"
        raise PlanspaceError(f"{out} {what}; give the folder of a run, such as runs/cartpole-swingup-small.")
    kinds = {"task": str, "budget": str, "seed": int}
    if missing := [name for name, kind in kinds.items() if type(config.get(name)) is not kind]:
        raise PlanspaceError(
            f"{out / CONFIG} has no valid {missing[0]}; restore the file from a copy, or run again with "
            "another --out."
        )
    task = stored_task(out) if "task_sha256" in config else None
    return run(task or config["task"], config["budget"], out, config["seed"])


def _config(task: Task, budget_name: str, budget: Budget, seed: int) -> dict[str, Any]:
    """The content of `config.json`."""
    return {
        "command": "run",
        "task": task.name,
        **task_content(task),
        "budget": budget_name,
        "seed": seed,
        "settings": asdict(budget),
        "version": planspace.__version__,
    }
