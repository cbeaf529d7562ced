"""`planspace run`: plan, embed, train and report in one command."""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

import planspace
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.config import PRESETS, FitConfig
from planspace.embed.fit import fit_embedding
from planspace.embed.saved_embedding import DESCRIPTION
from planspace.errors import PlanspaceError, unknown
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.rl.config import TrainConfig
from planspace.rl.history import frozen_seeds
from planspace.rl.training import train_policies
from planspace.storage.arrays import Arrays
from planspace.storage.checks import CONFIG, reject_malformed
from planspace.storage.json_files import read_json, write_json
from planspace.storage.runs import open_run
from planspace.study.quickstart_report import FINAL_ITERATIONS, GEOMETRY_ROWS, write_report
from planspace.tasks.catalog import find_task
from planspace.tasks.problem_file import load_problem

BudgetName = Literal["smoke", "small", "full"]
NEAR_GOAL = 0.5
"""Demonstrations that end within this L1 distance of the goal count as near it."""


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


def run(task_name: str, budget_name: BudgetName, out: Path, seed: int) -> dict[str, Any]:
    """Plan, embed, train and report. Finished stages are kept, and an interrupted stage continues.

    Args:
        task_name: a task's command-line name.
        budget_name: a key of `BUDGETS`.
        out: the run's folder.
        seed: the seed of every stage.

    Returns:
        The summary, as in `summary.json`.

    Raises:
        PlanspaceError: a stage failed; what was done before it is saved.
    """
    task = find_task(task_name)
    if budget_name not in BUDGETS:
        raise unknown("budget", budget_name, BUDGETS)
    budget = BUDGETS[budget_name]
    open_run(
        out,
        {
            "command": "run",
            "task": task_name,
            "budget": budget_name,
            "seed": seed,
            "settings": asdict(budget),
            "version": planspace.__version__,
        },
    )
    problem = load_problem(task.problem)
    plan_into(problem, out / "demos", num=budget.demos, seed=seed, config=budget.planner)
    demos = load_demos(out / "demos")
    embedding = fit_embedding(
        demos, config=budget.fit, out=out / "embedding", num_seeds=budget.embedding_seeds, seed=seed
    )
    arms = _arms(task_name, budget, seed)
    histories = {
        label: train_policies(
            task, config, embedding=embedding if config.z != "none" else None, out=out / "train" / folder
        ).history
        for label, folder, config in arms
    }
    with reject_malformed(out / "embedding" / DESCRIPTION):
        geometry = _geometry(embedding.about)
    summary = summarise(task_name, budget_name, seed, demos, geometry, histories)
    reports = [(label, frozen_seeds(histories[label], config.seeds)) for label, _, config in arms]
    summary["diverged"] = [f"{label}: {text}" for label, text in reports if text]
    write_json(out / "summary.json", summary)
    write_report(out, summary, demos, embedding, histories)
    return summary


def rebuild(out: Path) -> dict[str, Any]:
    """Write the report of a run again, from its folder.

    Raises:
        PlanspaceError: it is no run, its settings are not whole, or as `run` does.
    """
    config = read_json(out / CONFIG)
    if config.get("command") != "run":
        raise PlanspaceError(f"{out} is not the folder of a `planspace run`.")
    kinds = {"task": str, "budget": str, "seed": int}
    if missing := [name for name, kind in kinds.items() if type(config.get(name)) is not kind]:
        raise PlanspaceError(
            f"{out / CONFIG} does not say the run's {missing[0]}; restore it from a copy, or run anew "
            "elsewhere."
        )
    return run(config["task"], config["budget"], out, config["seed"])


def _arms(task_name: str, budget: Budget, seed: int) -> list[tuple[str, str, TrainConfig]]:
    """Label, folder and settings of each arm. Tasks that observe sin and cos already have no `trig` arm."""
    base = TrainConfig(num_seeds=budget.seeds, seed=seed, steps=budget.steps)
    raw = ("raw", "raw", base)
    if not find_task(task_name).sin_cos_columns:
        return [raw, ("raw + z", "raw-z", replace(base, z="augment"))]
    return [
        raw,
        ("raw + sin/cos", "trig", replace(base, obs="trig")),
        ("raw + sin/cos + z", "trig-z", replace(base, obs="trig", z="augment")),
    ]


def summarise(
    task_name: str,
    budget_name: str,
    seed: int,
    demos: Demos,
    geometry: dict[str, Any],
    histories: dict[str, Arrays],
) -> dict[str, Any]:
    """The closing table as plain data."""
    distances = _end_distances(demos)
    durations = demos.times[demos.offsets[1:] - 1]
    return {
        "task": task_name,
        "budget": budget_name,
        "seed": seed,
        "version": planspace.__version__,
        "demos": {
            "count": len(demos),
            "share_near_goal": float(np.mean(distances <= NEAR_GOAL)),
            "near_goal": NEAR_GOAL,
            "median_end_distance": float(np.median(distances)),
            "median_duration_s": float(np.median(durations)),
        },
        "geometry": geometry,
        "arms": {label: _arm_row(history) for label, history in histories.items()},
    }


def _geometry(about: dict[str, Any]) -> dict[str, Any]:
    """The metrics of the test split, as the embedding's description has them."""
    return {
        "split": "test",
        "embedding_seed": about["seed"],
        "embedding": _without_nan(about["metrics"]["test"]),
        "raw_state": _without_nan(about["metrics_raw_state"]),
    }


def _arm_row(history: Arrays) -> dict[str, Any]:
    final = history["return"][-FINAL_ITERATIONS:].mean(axis=0)
    return {
        "steps": int(history["steps"][-1]),
        "seeds": len(final),
        "mean": float(final.mean()),
        "worst": float(final.min()),
        "best": float(final.max()),
        "deviation": float(final.std(ddof=1)) if len(final) > 1 else 0.0,
    }


def _end_distances(demos: Demos) -> np.ndarray:
    _, space = demos.info.compile()
    return space.distance(demos.states[demos.offsets[1:] - 1], demos.goals)


def _without_nan(metrics: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in metrics.items()}


def closing_table(summary: dict[str, Any]) -> str:
    """The summary as text for a terminal."""
    demos, geometry = summary["demos"], summary["geometry"]
    lines = [
        f"{summary['task']}, budget {summary['budget']}, seed {summary['seed']}",
        "",
        f"demonstrations   {demos['count']} planned, {demos['share_near_goal']:.0%} end within "
        f"{demos['near_goal']} of the goal (median {demos['median_end_distance']:.3f}), median duration "
        f"{demos['median_duration_s']:.2f} s",
        "",
        f"geometry on {geometry['embedding']['num_demos']} test demos    z     raw state",
    ]
    lines += [
        f"  {name:<22}{_metric(geometry['embedding'][key]):>8}"
        f"{_metric(geometry['raw_state'][key]):>12}   {hint}"
        for key, name, hint in GEOMETRY_ROWS
    ]
    lines += ["", f"return of TRPO, last {FINAL_ITERATIONS} iterations    mean     worst      best   seeds"]
    lines += [
        f"  {label:<28}{row['mean']:>12.1f}{row['worst']:>10.1f}{row['best']:>10.1f}{row['seeds']:>8}"
        for label, row in summary["arms"].items()
    ]
    return "\n".join(lines)


def _metric(value: float | None) -> str:
    """A metric with three decimals; `-` if too few demonstrations define it."""
    return "-" if value is None else f"{value:.3f}"
