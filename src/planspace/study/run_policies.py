"""The policies of `planspace run --train`: TRPO with and without z, and verdicts on their returns."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planspace.embed.embedding import Embedding
from planspace.rl.config import TrainConfig
from planspace.rl.history import frozen_seeds
from planspace.rl.learning_curve import Curve
from planspace.rl.training import train_policies
from planspace.storage.arrays import Arrays
from planspace.study.budgets import Budget
from planspace.study.design import Claim
from planspace.study.stats import HOLDS, MIN_SEEDS, Scores, judge
from planspace.tasks.task import Task

TRAIN = "train"
"""The folder of the policies in the folder of a run."""
BANDS = Path(__file__).parent / "bands"
"""TASK.csv: learning curves of 15 seeds, made by benchmarks/run_bands.py from results/study."""
BAND_STEPS = 100_000
"""Steps between two points of a band."""
FEWEST_ROWS = 2
"""A band is drawn from this many of its points on."""


@dataclass(frozen=True)
class Policies:
    """The policies of a run."""

    histories: Mapping[str, Arrays]
    """The training history of each arm, by its label."""
    diverged: tuple[str, ...]
    """One text per arm with seeds that diverged."""
    folder: str
    """The folder of the last arm, which observes z."""


def train_arms(task: Task, embedding: Embedding, out: Path, budget: Budget, seed: int) -> Policies:
    """Train the policies of each arm, or load them.

    Args:
        task: the task.
        embedding: computes z.
        out: the folder of the run.
        budget: seeds and steps.
        seed: the first seed.

    Raises:
        PlanspaceError: a folder cannot be written or was made with other settings.
    """
    arms = run_arms(task, budget, seed)
    histories = {
        label: train_policies(
            task, config, embedding=embedding if config.z != "none" else None, out=out / TRAIN / folder
        ).history
        for label, folder, config in arms
    }
    diverged = [(label, frozen_seeds(histories[label], config.seeds)) for label, _, config in arms]
    texts = tuple(f"{label}: {text}" for label, text in diverged if text)
    return Policies(histories, texts, arms[-1][1])


def run_arms(task: Task, budget: Budget, seed: int) -> list[tuple[str, str, TrainConfig]]:
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


def verdicts(histories: Mapping[str, Arrays]) -> tuple[str, ...]:
    """Say in one sentence for each other arm whether the seeds separate it from the last arm.

    The interval is that of `study.stats` for the difference of mean final returns: a paired bootstrap.
    """
    if not histories:
        return ()
    *others, last = histories
    return tuple(_verdict(other, histories[other], last, histories[last]) for other in others)


def _verdict(other: str, lower: Arrays, last: str, upper: Arrays) -> str:
    num = upper["return"].shape[1]
    if num < MIN_SEEDS:
        return f"{num} seeds are too few to compare {last} with {other}."
    claim = Claim("", "", "final", last, other)
    found = judge(claim, _scores(upper), _scores(lower))
    low, high = found.interval
    numbers = f"{found.number:+.0f} (95 % interval {low:.0f} to {high:.0f})"
    if low <= 0 <= high:
        return f"{num} seeds cannot separate {other} from {last}: the difference in return is {numbers}."
    better = "more" if found.verdict == HOLDS else "less"
    return f"{last} earns {better} than {other}: the difference in return is {numbers}, with {num} seeds."


def _scores(history: Arrays) -> Scores:
    num = history["return"].shape[1]
    return Scores(tuple(range(num)), history["steps"], history["return"], 0)


def shipped_bands(task: str, last_step: int) -> dict[str, Curve]:
    """Learning curves of 15 seeds by the arm's label, up to a step; empty if too little is shipped.

    Args:
        task: name of the task.
        last_step: the environment steps per seed of the curves that the bands are drawn under.
    """
    file = BANDS / f"{task}.csv"
    if not file.is_file():
        return {}
    with file.open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if int(row["steps"]) <= last_step + BAND_STEPS]
    found = {}
    for arm in dict.fromkeys(row["arm"] for row in rows):
        own = [row for row in rows if row["arm"] == arm]
        steps, mean, low, high = (
            np.array([float(row[key]) for row in own]) for key in ("steps", "mean", "low", "high")
        )
        if len(own) >= FEWEST_ROWS:
            found[arm] = Curve(steps.astype(int), mean, low, high, mean)
    return found
