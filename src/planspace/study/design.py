"""The design of a study: arms, their units, and claims with the numbers that decide them."""

import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from planspace.control.config import ControlConfig
from planspace.embed.config import FitConfig
from planspace.errors import UsageError
from planspace.rl.config import TrainConfig
from planspace.study.unit import DemosUnit, FitUnit, GuideUnit, PlansUnit, PolicyUnit, Unit
from planspace.tasks.catalog import find_task
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem, shipped_problems
from planspace.tasks.task import Task

Measure = Literal["final", "early", "whole", "best", "spread", "early_spread"]
SPREADS: tuple[Measure, ...] = ("spread", "early_spread")
Expectation = Literal["more", "less", "same"]

RAW, SWING_UP = "raw", "cartpole-swingup"
BLOCK = 5
"""Seeds per unit. An arm has several units, so 15 seeds become 50 without running the first 15 again."""


@dataclass(frozen=True)
class Budget:
    """How much of each stage to run."""

    steps: int
    """Environment steps per seed."""
    seeds: int = 15
    """Seeds per arm."""
    plans: int = 500
    """Number of demonstrations; 2020 had 500."""
    embeddings: int = 5
    """Number of embeddings."""
    restarts: int | None = None
    """Searches per plan; None uses the planner's default."""
    fit_steps: int | None = None
    """Optimiser steps of an embedding; None uses the preset's."""
    guide_episodes: int = 30
    """Episodes of control that stand in for plans, those that missed the goal included."""


@dataclass(frozen=True)
class Arm:
    """An arm of a study: one line in a figure."""

    panel: str
    """The figure that shows the arm."""
    label: str
    """The arm's name in the figure."""
    units: tuple[PolicyUnit, ...]
    """One unit per block of seeds."""

    @property
    def task(self) -> str:
        """The task of the arm's figure. A unit that several arms share may name another task."""
        return self.panel.partition(",")[0]

    @property
    def name(self) -> str:
        """Panel and label."""
        return f"{self.panel}/{self.label}"

    @property
    def num_embeddings(self) -> int:
        """Number of embeddings that the seeds use in turn; 0 without z."""
        return len(self.units[0].fits)


def solved_level(arm: Arm) -> float | None:
    """The return above which a seed has solved the task of an arm; None for a reward without a level."""
    unit = arm.units[0]
    return find_task(unit.task).solved_return if unit.config.reward == "dense" else None


@dataclass(frozen=True)
class Claim:
    """A claim, and the number that decides it.

    The number is the measure of `arm`, minus the measure of `other` if there is one. For a spread it is the
    logarithm of the ratio other over arm. The number's 95 % interval decides. `more` holds if the interval
    lies above `margin` and fails if it lies below. `less` holds if the interval lies below -`margin` and
    fails if it lies above. `same` holds if the interval lies within +- `margin` and fails if it lies outside.
    """

    text: str
    source: str
    """Source of the claim."""
    measure: Measure
    """`final`, `early` and `whole`: mean return over the last 50 iterations, the first quarter and the whole
    training. `best`: mean `final` of the two best seeds. `spread` and `early_spread`: standard deviation over
    seeds of `final` and `early`."""
    arm: str
    """Name of the arm that the claim is about."""
    other: str
    """Name of the arm that it is compared with; empty for a claim about one arm."""
    expects: Expectation = "more"
    margin: float = 0.0
    late: bool = False
    """Whether the claim was made or changed after the returns of some seeds were known."""


@dataclass(frozen=True)
class Study:
    """A study: its arms and claims."""

    name: str
    budget: str
    question: str
    arms: tuple[Arm, ...]
    claims: tuple[Claim, ...] = ()
    notes: tuple[str, ...] = ()
    """Notes for readers of the report."""
    parts: tuple[str, ...] = ()
    """The arguments of `only`."""
    task: str = ""
    """The task as it was given, such as `crane.yaml`; empty for the study's own tasks."""
    folder: str = ""
    """The folder of the report; by default `NAME-BUDGET`."""
    seeds: int = 0
    """Seeds per arm, as given; 0 if the study's own numbers are used."""
    evaluated: bool = False
    """Whether the study compares returns of evaluations, whose episodes all start as the task says, instead
    of returns of training episodes, which may start at states of plans."""

    @property
    def command(self) -> str:
        """The command that runs the study."""
        task = f" {shlex.quote(self.task)}" if self.task else ""
        seeds = f" --seeds {self.seeds}" if self.seeds else ""
        only = "".join(f" --only {shlex.quote(part)}" for part in self.parts)
        return f"planspace study {self.name}{task} --budget {self.budget}{seeds}{only}"

    @property
    def units(self) -> tuple[Unit, ...]:
        """Every unit once, each after the units that it needs."""
        units = [unit for arm in self.arms for unit in (*all_needs(arm.units), *arm.units)]
        return tuple({unit.name: unit for unit in units}.values())

    def only(self, parts: Iterable[str]) -> "Study":
        """The study with only the arms whose names contain one of these texts, and the claims about them.

        Raises:
            UsageError: no arm's name contains any of the texts.
        """
        parts = tuple(parts)
        selected = tuple(arm for arm in self.arms if not parts or any(part in arm.name for part in parts))
        if not selected:
            names = "; ".join(arm.name for arm in self.arms)
            texts = " or ".join(repr(part) for part in parts)
            raise UsageError(f"no arm of study {self.name} has {texts} in its name. Its arms: {names}.")
        names = {arm.name for arm in selected}
        claims = tuple(c for c in self.claims if c.arm in names and (not c.other or c.other in names))
        return replace(self, arms=selected, claims=claims, parts=parts)


@dataclass(frozen=True)
class Builder:
    """Builds the units of a budget."""

    budget: Budget
    seeds: int = 0
    """Seeds per arm; 0 uses the study's number."""
    seed: int = 0
    """The first seed."""
    task: str | Task = ""
    """The task that the study is about; empty for the study's own tasks."""

    def arm(
        self,
        panel: str,
        label: str,
        task: str | Task,
        config: TrainConfig,
        fits: Iterable[FitUnit] = (),
        seeds: int = 0,
        demos: DemosUnit | None = None,
    ) -> Arm:
        """Make an arm, with one unit per block of seeds.

        Args:
            panel: the figure that shows the arm.
            label: the arm's name in the figure.
            task: the name of a shipped task, or a task of your own.
            config: settings of the arm. The budget sets steps and seeds.
            fits: the embeddings that provide z, used in turn.
            seeds: number of seeds; 0 uses the budget's number.
            demos: the demonstrations that training uses, if the settings say that it uses some.
        """
        fits = tuple(fits)
        num = self.seeds or seeds or self.budget.seeds
        starts = range(self.seed, self.seed + num, BLOCK)
        blocks = ((start, min(BLOCK, self.seed + num - start)) for start in starts)
        configs = (replace(config, steps=self.budget.steps, seed=s, num_seeds=n) for s, n in blocks)
        return Arm(panel, label, tuple(PolicyUnit(task, c, fits, demos) for c in configs))

    def plans_for(self, given: str | Task, num: int = 0) -> PlansUnit:
        """Demonstrations to train a task's embeddings: `num`, or the budget's number if that is smaller.

        Raises:
            UsageError: the task has no planning problem.
        """
        task = find_task(given)
        problem = task.embedding_problem or task.problem
        if not problem:
            raise UsageError(
                f"task {task.name!r} has no planning problem, so a study cannot plan its demonstrations: set "
                "its field `problem`."
            )
        return self.plans(problem, num)

    def plans(self, problem: str | Path | Problem, num: int = 0, **settings: int | float) -> PlansUnit:
        """Demonstrations of a planning problem: `num`, or the budget's number if that is smaller."""
        if self.budget.restarts is not None:
            settings["restarts"] = self.budget.restarts
        num = min(num or self.budget.plans, self.budget.plans)
        if not isinstance(problem, str) or problem not in shipped_problems():
            problem = load_problem(problem)
        return PlansUnit(problem, num, tuple(sorted(settings.items())))

    def fit(self, plans: PlansUnit, config: FitConfig, **seeds: int) -> FitUnit:
        """An embedding. `seeds` are the arguments `num_seeds` and `seed` of `FitUnit`."""
        steps = self.budget.fit_steps or config.steps
        return FitUnit(plans, replace(config, steps=steps), **seeds)

    def guide(self, task: str | Task, plans: PlansUnit, fit: FitUnit, config: ControlConfig) -> GuideUnit:
        """Episodes of control by distance in the z of an embedding, which may follow plans."""
        return GuideUnit(task, plans, fit, self.budget.guide_episodes, config)

    def fits(self, plans: PlansUnit, config: FitConfig, num: int = 0, first: int = 0) -> tuple[FitUnit, ...]:
        """Embeddings with different seeds, to use in turn."""
        num = min(num or self.budget.embeddings, self.budget.embeddings)
        return tuple(self.fit(plans, config, seed=seed) for seed in range(first, first + num))


def all_needs(units: Iterable[Unit]) -> Iterator[Unit]:
    """All units that some units need, directly or not, each after those that it needs."""
    for unit in units:
        for need in unit.needs:
            yield from all_needs([need])
            yield need


def better(panel: str, text: str, arm: str, other: str, margin: float = 0.0) -> Claim:
    """The claim that the final return of an arm is higher than that of another arm of the same figure."""
    return Claim(f"{panel}: {text}", "ours", "final", f"{panel}/{arm}", f"{panel}/{other}", margin=margin)


def panel_of(task: str | Task, algo: str) -> str:
    """Name of the figure of a task and an algorithm."""
    return f"{find_task(task).name}, {algo.upper()}"
