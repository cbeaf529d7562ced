"""The units a study is made of: demonstrations, embeddings, and policies of a few seeds.

A unit is plain data. Its name is the hash of all that it depends on, so the same unit of two studies is one,
and is run once. Tasks are known by their names alone: what they are is part of planspace's version, and a
folder of results takes one version.
"""

from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal

from planspace.embed.config import FitConfig
from planspace.rl.config import TrainConfig
from planspace.seams import plain_settings
from planspace.storage.json_files import json_hash
from planspace.tasks.problem_file import load_problem

PlanSource = Literal["plan", "2020"]

SECONDS_A_PLAN = {"plan": 0.85, "2020": 2.0}
SECONDS_A_TRIPLET = 4.5e-6
STEPS_A_SECOND = 50_000.0
"""Environment steps that one core trains in a second, roughly, for an algorithm without `steps_a_second`. The
time left is estimated from it until units are done."""


class _Unit:
    """What all units share."""

    kind: ClassVar[str]

    @cached_property
    def spec(self) -> dict[str, Any]:
        """Everything it depends on, as plain data."""
        return {"kind": self.kind, **_plain(self)}

    @cached_property
    def name(self) -> str:
        """Its kind and the hash of `spec`."""
        return f"{self.kind}-{json_hash(self.spec)[:16]}"


@dataclass(frozen=True)
class PlansUnit(_Unit):
    """A dataset of demonstrations."""

    kind = "plans"
    problem: str
    """A shipped planning problem."""
    num: int
    """How many."""
    settings: tuple[tuple[str, int | float], ...] = ()
    """What differs from the problem's planner settings."""
    source: PlanSource = "plan"
    """`plan`: our planner. `2020`: plans as wrong as those of 2020; see `wound`."""
    seed: int = 0

    @property
    def needs(self) -> tuple["Unit", ...]:
        """Units whose folders it reads."""
        return ()

    @property
    def cost(self) -> float:
        """A guess of the seconds it takes one core."""
        return SECONDS_A_PLAN[self.source] * self.num


@dataclass(frozen=True)
class FitUnit(_Unit):
    """An embedding: the best of some seeds."""

    kind = "fit"
    plans: PlansUnit
    """What it is trained on."""
    config: FitConfig
    """How."""
    num_seeds: int = 1
    """How many seeds, of which the best is kept."""
    seed: int = 0
    """The first."""

    @property
    def needs(self) -> tuple["Unit", ...]:
        """Units whose folders it reads."""
        return (self.plans,)

    @property
    def cost(self) -> float:
        """A guess of the seconds it takes one core."""
        return self.num_seeds * (3.0 + SECONDS_A_TRIPLET * self.config.steps * self.config.batch)


@dataclass(frozen=True)
class PolicyUnit(_Unit):
    """Policies of some neighbouring seeds of an arm."""

    kind = "policies"
    task: str
    """A shipped task."""
    config: TrainConfig
    """The arm, and which seeds."""
    fits: tuple[FitUnit, ...] = ()
    """What makes z; seed s takes number s modulo how many there are."""

    @property
    def needs(self) -> tuple["Unit", ...]:
        """Units whose folders it reads."""
        return self.fits

    @property
    def cost(self) -> float:
        """A guess of the seconds it takes one core."""
        rate = getattr(self.config.algorithm, "steps_a_second", STEPS_A_SECOND)
        return self.config.steps * self.config.num_seeds / rate


Unit = PlansUnit | FitUnit | PolicyUnit


def _plain(value: Any) -> Any:
    """Dataclasses as plain data, presets resolved."""
    if isinstance(value, TrainConfig | FitConfig):
        return plain_settings(value)
    if is_dataclass(value):
        problem = {"problem_hash": _problem_hash(value.problem)} if isinstance(value, PlansUnit) else {}
        return {**{f.name: _plain(getattr(value, f.name)) for f in fields(value)}, **problem}
    return [_plain(x) for x in value] if isinstance(value, tuple) else value


@lru_cache
def _problem_hash(name: str) -> str:
    """Read once: hundreds of units of a study name it."""
    return load_problem(name).hash
