"""`planspace run`: plan, embed, train and report in one command."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import planspace
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.config import PRESETS, FitConfig
from planspace.embed.fit import fit_embedding
from planspace.errors import PartialResult, PlanspaceError, unknown
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.rl.config import TrainConfig
from planspace.rl.history import frozen_seeds
from planspace.rl.training import train_policies
from planspace.storage.checks import CONFIG
from planspace.storage.json_files import read_json, write_json
from planspace.storage.runs import lock_folder, open_run
from planspace.study.quickstart_report import write_report
from planspace.study.run_summary import ArmReturns, DemosSummary, GeometrySummary, RunSummary, as_json
from planspace.tasks.catalog import find_task
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem
from planspace.tasks.stored_task import save_task, stored_task, task_content
from planspace.tasks.task import Task

BudgetName = Literal["smoke", "small", "full"]


@dataclass(frozen=True)
class Budget:
    """How much of each stage to run."""

    demos: int
    """Number of demonstrations to plan."""
    planner: PlanConfig
    """Settings of planning."""
    fit: FitConfig
    """Settings of training the embedding."""
    embedding_seeds: int
    """Number of embedding seeds. The best one is selected."""
    seeds: int
    """Number of policy seeds per arm."""
    steps: int
    """Environment steps per policy seed."""


BUDGETS: dict[str, Budget] = {
    "smoke": Budget(
        demos=12,
        planner=PlanConfig(restarts=1),
        fit=replace(PRESETS["modern"], steps=1_500),
        embedding_seeds=5,
        seeds=5,
        steps=40_000,
    ),
    "small": Budget(
        demos=60,
        planner=PlanConfig(),
        fit=PRESETS["modern"],
        embedding_seeds=5,
        seeds=5,
        steps=960_000,
    ),
    "full": Budget(
        demos=300,
        planner=PlanConfig(),
        fit=PRESETS["modern"],
        embedding_seeds=5,
        seeds=15,
        steps=2_000_000,
    ),
}


def run(given: str | Path | Task, budget_name: BudgetName, out: Path, seed: int) -> RunSummary:
    """Plan, embed, train and report. Finished stages are kept, and an interrupted stage is resumed.

    Args:
        given: a task's command-line name, the path of a problem file, or a task with a planning problem.
        budget_name: a key of `BUDGETS`.
        out: the run's folder.
        seed: the seed of every stage.

    Returns:
        The summary that `summary.json` holds.

    Raises:
        PlanspaceError: a stage failed. Earlier work is saved.
    """
    task = find_task(given)  # refuses an unknown name before anything is written
    if budget_name not in BUDGETS:
        raise unknown("budget", budget_name, BUDGETS)
    with lock_folder(out):
        open_run(out, _config(task, budget_name, BUDGETS[budget_name], seed))
        save_task(task, out)
        return _run_stages(task, budget_name, out, seed)


def _run_stages(task: Task, budget_name: BudgetName, out: Path, seed: int) -> RunSummary:
    budget = BUDGETS[budget_name]
    problem = load_problem(task.problem)
    demos, unsolved = _plan(problem, out / "demos", budget, seed)
    embedding = fit_embedding(
        demos, config=budget.fit, out=out / "embedding", num_seeds=budget.embedding_seeds, seed=seed
    )
    arms = _arms(task, budget, seed)
    histories = {
        label: train_policies(
            task, config, embedding=embedding if config.z != "none" else None, out=out / "train" / folder
        ).history
        for label, folder, config in arms
    }
    diverged = [(label, frozen_seeds(histories[label], config.seeds)) for label, _, config in arms]
    summary = RunSummary(
        task=task.name,
        budget=budget_name,
        seed=seed,
        version=planspace.__version__,
        demos=DemosSummary.of(demos),
        geometry=GeometrySummary.of(embedding.require_about()),
        arms={label: ArmReturns.of(history) for label, history in histories.items()},
        diverged=tuple(f"{label}: {text}" for label, text in diverged if text),
        unsolved=unsolved,
    )
    write_json(out / "summary.json", as_json(summary))
    write_report(out, summary, demos, embedding, histories)
    return summary


def _plan(problem: Problem, out: Path, budget: Budget, seed: int) -> tuple[Demos, str]:
    """The demonstrations, and the message about those that were not found; a run goes on without them."""
    try:
        plan_into(problem, out, num=budget.demos, seed=seed, config=budget.planner)
    except PartialResult as partial:
        try:
            return load_demos(out), str(partial)
        except PlanspaceError:  # none was found
            raise partial from None
    return load_demos(out), ""


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


def _arms(task: Task, budget: Budget, seed: int) -> list[tuple[str, str, TrainConfig]]:
    """Label, folder and settings of each arm. Tasks that observe sin and cos already have no `trig` arm."""
    base = TrainConfig(num_seeds=budget.seeds, seed=seed, steps=budget.steps)
    raw = ("raw", "raw", base)
    if not task.sin_cos_columns:
        return [raw, ("raw + z", "raw-z", replace(base, z="augment"))]
    return [
        raw,
        ("raw + sin/cos", "trig", replace(base, obs="trig")),
        ("raw + sin/cos + z", "trig-z", replace(base, obs="trig", z="augment")),
    ]
