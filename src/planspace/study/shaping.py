"""The study `shaping`: does reward shaping by distance in z help?"""

from collections.abc import Iterator
from dataclasses import replace

from planspace.embed.config import PRESETS
from planspace.rl.config import ShapingType, TrainConfig
from planspace.study.design import SWING_UP, Arm, Builder, Study, better, panel_of
from planspace.tasks.observation_types import RewardType

UNSHAPED, SHAPED_BY_Z = "unshaped", "shaped by z"
SHAPINGS: dict[str, ShapingType] = {UNSHAPED: "none", SHAPED_BY_Z: "z", "shaped by raw distance": "raw"}
REWARDS: tuple[RewardType, ...] = ("dense", "sparse")
SHAPING_SCALE = 100.0
"""Total shaping reward from an average start to the goal: a seventh of the range from idle to solved."""


def shaping(budget: str, grid: Builder) -> Study:
    """Compare shaping by distance in z, by raw distance, and none, with dense and with sparse reward."""
    panels: dict[str, RewardType] = {f"{panel_of(SWING_UP, 'trpo')}, {r} reward": r for r in REWARDS}
    return Study(
        "shaping",
        budget,
        "Does reward shaping by distance in z help?",
        tuple(arm for panel, reward in panels.items() for arm in _arms(panel, reward, grid)),
        tuple(
            better(panel, f"{SHAPED_BY_Z} is better than {other}", SHAPED_BY_Z, other)
            for panel in panels
            for other in SHAPINGS
            if other != SHAPED_BY_Z
        ),
        ("Policies observe raw + sin/cos. Returns do not include the shaping.",),
    )


def _arms(panel: str, reward: RewardType, grid: Builder) -> Iterator[Arm]:
    fits = grid.fits(grid.plans_for(SWING_UP), PRESETS["modern"])
    plain = TrainConfig(obs="trig", reward=reward)
    for label, form in SHAPINGS.items():
        shaped = replace(plain, shaping=form, shaping_scale=SHAPING_SCALE)
        yield grid.arm(
            panel, label, SWING_UP, plain if form == "none" else shaped, fits if form == "z" else ()
        )
