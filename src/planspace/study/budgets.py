"""How much of each stage `planspace run` does."""

from dataclasses import dataclass, replace
from typing import Literal

from planspace.embed.config import PRESETS, FitConfig
from planspace.plan.config import PlanConfig

BudgetName = Literal["smoke", "small", "full"]
HORIZON_S = 0.32
"""How far the controller looks ahead where distance in z is compared with raw distance [s]."""


@dataclass(frozen=True)
class ControlBudget:
    """How much of the control stage to run."""

    starts: int
    """Starts that are controlled by distance in z and by raw distance, `HORIZON_S` ahead."""
    samples: int
    """Candidates per control step."""
    horizons: tuple[float, ...]
    """How far ahead success is measured with each cost [s]; may be empty."""
    horizon_starts: int
    """Starts that are controlled for each cost and horizon: the first of `starts`."""


@dataclass(frozen=True)
class Budget:
    """How much of each stage to run."""

    demos: int
    """Number of demonstrations to plan."""
    planner: PlanConfig
    """Settings of planning. A problem with settings of its own uses those, with the restarts of these."""
    fit: FitConfig
    """Settings of training the embedding."""
    embedding_seeds: int
    """Number of embedding seeds. The best one is selected."""
    control: ControlBudget
    """How much of the control stage to run."""
    seeds: int
    """Number of policy seeds per arm, with `--train`."""
    steps: int
    """Environment steps per policy seed, with `--train`."""


BUDGETS: dict[str, Budget] = {
    "smoke": Budget(
        demos=12,
        planner=PlanConfig(restarts=1),
        fit=replace(PRESETS["modern"], steps=1_000, batch=128),
        embedding_seeds=3,  # one group of seeds, so that one program is compiled
        control=ControlBudget(starts=4, samples=64, horizons=(), horizon_starts=0),
        seeds=5,
        steps=40_000,
    ),
    "small": Budget(
        demos=60,
        planner=PlanConfig(),
        fit=PRESETS["modern"],
        embedding_seeds=5,
        control=ControlBudget(starts=50, samples=128, horizons=(0.16, HORIZON_S, 0.64), horizon_starts=10),
        seeds=5,
        steps=960_000,
    ),
    "full": Budget(
        demos=300,
        planner=PlanConfig(),
        fit=PRESETS["modern"],
        embedding_seeds=5,
        control=ControlBudget(starts=200, samples=256, horizons=(0.16, HORIZON_S, 0.64), horizon_starts=50),
        seeds=15,
        steps=2_000_000,
    ),
}
