"""The units of a study: demonstrations, embeddings, guides, and policies of a few seeds.

A unit is plain data. Its name contains a hash of everything it depends on, so a unit that two studies share
is run once. Of a shipped task, only the name is hashed: its content is fixed by the version of planspace, and
all results in a folder are from one version. Of a user's own task and problem, the content is hashed too.
"""

from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal

from planspace.control.config import ControlConfig
from planspace.embed.config import FitConfig
from planspace.rl.config import TrainConfig
from planspace.seams import UNSET_IF_NONE, is_unset, plain_settings
from planspace.storage.json_files import json_hash
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem
from planspace.tasks.task import Task

PlanSource = Literal["plan", "2020"]

SECONDS_PER_PLAN = {"plan": 1.0, "2020": 4.2}
SECONDS_PER_TRIPLET = 6e-6
SECONDS_PER_EPISODE = 10.0
START_S = 6.0
"""Seconds that the policies of a unit take before their first step: imports and compilation."""
STEPS_PER_SECOND = 37_000.0
"""Rough number of environment steps that one core trains per second, for algorithms without `steps_a_second`.
The time left is estimated from these constants until units are finished."""


class _Unit:
    """The name of a unit."""

    kind: ClassVar[str]

    @cached_property
    def spec(self) -> dict[str, Any]:
        """Everything that the unit depends on, as plain data."""
        return {"kind": self.kind, **_plain(self)}

    @cached_property
    def name(self) -> str:
        """The unit's kind and the hash of `spec`."""
        return f"{self.kind}-{json_hash(self.spec)[:16]}"


@dataclass(frozen=True)
class PlansUnit(_Unit):
    """A dataset of demonstrations."""

    kind = "plans"
    problem: str | Problem
    """The name of a shipped planning problem, or a problem of your own."""
    num: int
    """Number of demonstrations."""
    settings: tuple[tuple[str, int | float], ...] = ()
    """Planner settings that differ from the problem's."""
    source: PlanSource = "plan"
    """`plan`: the planner. `2020`: plans with winding, like those of 2020; see `plans_2020`."""
    seed: int = 0

    @property
    def problem_name(self) -> str:
        """The name of the problem."""
        return self.problem if isinstance(self.problem, str) else self.problem.name

    @property
    def needs(self) -> tuple["Unit", ...]:
        """Units whose folders this one reads."""
        return ()

    @property
    def cost(self) -> float:
        """Estimated seconds on one core."""
        return SECONDS_PER_PLAN[self.source] * self.num


@dataclass(frozen=True)
class FitUnit(_Unit):
    """An embedding, selected among several seeds."""

    kind = "fit"
    plans: PlansUnit
    """The demonstrations to train on."""
    config: FitConfig
    """Settings of the training."""
    num_seeds: int = 1
    """Number of seeds. The best one is selected."""
    seed: int = 0
    """The first seed."""

    @property
    def needs(self) -> tuple["Unit", ...]:
        """Units whose folders this one reads."""
        return (self.plans,)

    @property
    def cost(self) -> float:
        """Estimated seconds on one core."""
        return self.num_seeds * (3.0 + SECONDS_PER_TRIPLET * self.config.steps * self.config.batch)


@dataclass(frozen=True)
class GuideUnit(_Unit):
    """Episodes of control in plan space that stayed at the goal. They can take the place of plans."""

    kind = "guide"
    source = "control"
    settings = ()
    task: str | Task
    """The name of a shipped task, or a task of your own."""
    plans: PlansUnit
    """The plans that control may follow."""
    fit: FitUnit
    """The embedding that computes distances."""
    num: int
    """Number of episodes, those that missed the goal included."""
    config: ControlConfig
    """Settings of the controller."""
    seed: int = 0

    @property
    def problem_name(self) -> str:
        """The name of the task."""
        return self.task if isinstance(self.task, str) else self.task.name

    @property
    def needs(self) -> tuple["Unit", ...]:
        """Units whose folders this one reads."""
        return (self.plans, self.fit)

    @property
    def cost(self) -> float:
        """Estimated seconds on one core."""
        return SECONDS_PER_EPISODE * self.num


DemosUnit = PlansUnit | GuideUnit


@dataclass(frozen=True)
class PolicyUnit(_Unit):
    """Policies of consecutive seeds of an arm."""

    kind = "policies"
    task: str | Task
    """The name of a shipped task, or a task of your own."""
    config: TrainConfig
    """Settings of the arm, and its seeds."""
    fits: tuple[FitUnit, ...] = ()
    """The embeddings that provide z. Seed s uses number s modulo their count."""
    demos: DemosUnit | None = field(default=None, metadata=UNSET_IF_NONE)
    """The demonstrations that training uses, for example as starts; None if it uses none."""

    @property
    def needs(self) -> tuple["Unit", ...]:
        """Units whose folders this one reads."""
        return self.fits if self.demos is None else (*self.fits, self.demos)

    @property
    def cost(self) -> float:
        """Estimated seconds on one core."""
        rate = getattr(self.config.algorithm, "steps_a_second", STEPS_PER_SECOND)
        return START_S + self.config.steps * self.config.num_seeds / rate


Unit = PlansUnit | FitUnit | GuideUnit | PolicyUnit


def _plain(value: Any) -> Any:
    """Convert dataclasses to plain data."""
    if isinstance(value, TrainConfig | FitConfig | ControlConfig):
        return plain_settings(value)
    if isinstance(value, Task | Problem):
        return value.name
    if is_dataclass(value):
        given = {f.name: getattr(value, f.name) for f in fields(value) if not is_unset(f, value)}
        return {**{name: _plain(item) for name, item in given.items()}, **_content(value)}
    return [_plain(x) for x in value] if isinstance(value, tuple) else value


def _content(unit: Any) -> dict[str, str]:
    """The hashes of a unit's problem and of its own task."""
    if isinstance(unit, PlansUnit):
        own = unit.problem
        return {"problem_hash": _shipped_hash(own) if isinstance(own, str) else own.hash}
    if isinstance(unit, PolicyUnit | GuideUnit) and isinstance(unit.task, Task):
        return {"task_sha256": unit.task.hash}
    return {}


@lru_cache
def _shipped_hash(name: str) -> str:
    """The hash of a shipped problem. It is cached, because hundreds of units name the same problem."""
    return load_problem(name).hash
