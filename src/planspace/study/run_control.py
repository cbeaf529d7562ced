"""The control stage of `planspace run`: the same starts by distance in z, by raw distance and by reward."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planspace.control.config import ControlConfig, CostName
from planspace.control.costs import support_note
from planspace.control.plant import Plant
from planspace.control.runs import EPISODES, control_into, successes
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.embedding import Embedding
from planspace.errors import UsageError
from planspace.study.budgets import HORIZON_S, ControlBudget
from planspace.study.paired import success_difference
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem
from planspace.tasks.task import Task

CONTROL = "control"
"""The folder of the stage in the folder of a run."""
COST_NAMES: dict[CostName, str] = {"z": "distance in z", "raw": "raw distance", "reward": "reward"}
"""How the costs are called in tables. Raw distance is that of the standardised states that the encoder
reads."""


@dataclass(frozen=True)
class Reached:
    """From how many of the same starts each cost succeeded, `horizon_s` ahead."""

    horizon_s: float
    starts: int
    z: int
    raw: int
    difference: float
    """Success by distance in z minus success by raw distance, as fractions."""
    interval: tuple[float, float]
    """Its 95 % interval; see `success_difference`."""


@dataclass(frozen=True)
class ControlResults:
    """The results of the control stage."""

    reached: Reached | None = None
    """None if the task cannot be controlled."""
    horizons: tuple[float, ...] = ()
    """How far ahead success was measured [s]."""
    horizon_starts: int = 0
    """Number of starts of each cell below."""
    by_horizon: tuple[tuple[CostName, tuple[int, ...]], ...] = ()
    """For each cost, the number of successes with each horizon."""
    notes: tuple[str, ...] = ()
    """What was left out, one sentence each."""


def control_stage(
    task: Task, embedding: Embedding, out: Path, budget: ControlBudget, seed: int
) -> ControlResults:
    """Control the same starts with each cost and horizon. Each cell is a run folder below `out/control`.

    What does not fit the task is left out, with a note.

    Args:
        task: the task; one whose targets are not states is replaced by its planning problem.
        embedding: computes z.
        out: the folder of the run.
        budget: how much to run.
        seed: seed of starts and samples.

    Raises:
        PlanspaceError: a folder cannot be written or was made with other settings.
    """
    plant, notes = find_plant(task)
    if plant is None:
        return ControlResults(notes=notes)
    first, *_ = usable_horizons((HORIZON_S,), plant.control_step)
    if first != HORIZON_S:
        notes += (
            f"A control step of {plant.task.name} takes {first:g} s, so the controller looks {first:g} s "
            f"ahead instead of {HORIZON_S:g} s.",
        )
    if note := support_note(plant, ControlConfig(), embedding):
        notes += (note[0].upper() + note[1:],)
    stage = _Stage(plant, embedding, out, budget.samples, seed)
    z, raw = (stage.control(cost, first, budget.starts) for cost in ("z", "raw"))
    difference, interval = success_difference(z, raw)
    horizons = usable_horizons(budget.horizons, plant.control_step)
    costs: list[CostName] = ["z", "raw"]
    if not isinstance(plant.task.problem, Problem):
        costs.append("reward")
    elif horizons:
        notes += ("The reward of this task is computed from its goal, so control by reward is left out.",)
    starts = min(budget.horizon_starts, budget.starts)
    rows: list[tuple[CostName, tuple[int, ...]]] = [
        (cost, tuple(sum(stage.control(cost, h, starts)) for h in horizons)) for cost in costs if horizons
    ]
    return ControlResults(
        Reached(first, len(z), sum(z), sum(raw), difference, interval), horizons, starts, tuple(rows), notes
    )


def controlled_episodes(out: Path, cost: CostName, horizon_s: float) -> Demos:
    """The episodes of a cell."""
    return load_demos(out / CONTROL / _folder(cost, horizon_s) / EPISODES)


def find_plant(task: Task) -> tuple[Plant | None, tuple[str, ...]]:
    """What is controlled for a task, and notes about it; None if it cannot be controlled."""
    notes: tuple[str, ...] = ()
    controlled: Task | Problem = task
    if task.target_size and not isinstance(task.problem, Problem):
        controlled = load_problem(task.problem)
        notes = (
            f"The targets of {task.name} are not states, so the planning problem {controlled.name} is "
            "controlled instead.",
        )
    try:
        plant = Plant.find(controlled)
    except UsageError as error:
        return None, (f"Control is left out: {error}",)
    simulator = plant.simulator(1)
    if not np.isfinite([simulator.control_low, simulator.control_high]).all():
        return None, (f"Control is left out: a control of {task.name} has no limits.",)
    return plant, notes


def usable_horizons(horizons: tuple[float, ...], step: float) -> tuple[float, ...]:
    """Horizons of at least one control step, without those of the same number of steps as another.

    Args:
        horizons: the horizons wanted, in rising order [s].
        step: the control step [s].
    """
    found: dict[int, float] = {}
    for horizon in horizons:
        found.setdefault(max(1, round(horizon / step)), horizon if round(horizon / step) else step)
    return tuple(found.values())


@dataclass(frozen=True)
class _Stage:
    plant: Plant
    embedding: Embedding
    out: Path
    samples: int
    seed: int

    def control(self, cost: CostName, horizon_s: float, num: int) -> list[bool]:
        """Whether each of the first starts succeeds."""
        folder = self.out / CONTROL / _folder(cost, horizon_s)
        control_into(
            self.plant,
            None if cost == "reward" else self.embedding,
            ControlConfig(horizon_s=horizon_s, cost=cost, samples=self.samples),
            folder,
            num=num,
            seed=self.seed,
            label=f"control by {cost}, {horizon_s:g} s",
        )
        return successes(folder)[:num]


def _folder(cost: CostName, horizon_s: float) -> str:
    return f"{cost}-{horizon_s:g}s"
