"""The study `uses`: which ways to use plans in training help, and does z help in addition?"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.embed.config import PRESETS
from planspace.errors import UsageError
from planspace.physics.simulator import control_bounds
from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.seams import with_settings
from planspace.study.design import SWING_UP, Arm, Builder, Claim, Study, better, panel_of
from planspace.tasks.catalog import find_task
from planspace.tasks.task import Task

TASK_NAMES = (SWING_UP, "pendulum-swingup", "quadrotor-planar", "acrobot-swingup")
ALGOS = ("sac", "trpo")
NUM_PLANS = 60
SAC_STEPS = 0.1
"""SAC trains for this fraction of the steps, because it takes a gradient step for each of them."""
SAC_HIDDEN = (64, 64)
"""Hidden layers of SAC. With its default of 256 x 256, the study would take several times as long."""
CLONED_STD = 0.1
"""First standard deviation of the actions of a cloned TRPO policy, as a fraction of half of the controls'
range (of its mean). TRPO's default, 1 in units of the control, would hide what was cloned."""
FOLLOW_S = 3.0
"""Part of a plan that the guide follows [s]."""
EVALUATIONS = 20
"""Evaluations of a training."""
MARGIN = 0.05
"""A claim needs a difference of more than this fraction of an episode's steps, the largest return."""
FIRST_SEED = 500
"""The first seed. No setting was chosen on these seeds."""

NO_PLANS, RESETS, REPLAY, CLONING, GUIDE = "no plans", "resets", "replay", "cloning", "guide"
BOTH, REVERSE = f"{RESETS} + {REPLAY}", f"{CLONING} + reverse {RESETS}"
NOTES = (
    "The reward is 1 for each step at the goal and 0 elsewhere. Returns are those of evaluations, whose "
    "episodes start as the task says. Policies use the preset modern, and observe sin and cos of angles. SAC "
    f"has networks of {SAC_HIDDEN[0]} x {SAC_HIDDEN[1]} and trains for a tenth of the steps of TRPO. At most "
    f"{NUM_PLANS} plans are used, and an arm with z has one embedding for all seeds. No setting was chosen "
    "on these seeds.",
    "resets: half of the training episodes start at plans. replay: half of each minibatch are steps of "
    "plans. reverse resets: the starts are at the end of plans at first. guide: episodes of control by "
    "distance in z, which follows plans, take the place of plans. Policies of TRPO that clone begin with "
    f"little noise, {CLONED_STD:g} of half of the controls' range. Claims need a difference of more than "
    f"{100 * MARGIN:.0f} % of an episode's steps.",
)


@dataclass(frozen=True)
class Use:
    """A way to use plans in training: an arm."""

    settings: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    """Settings of `TrainConfig` that differ from those of the arm without plans."""
    objective: str = ""
    """Name of the objective of the encoder that provides z; empty for no z."""
    guided: bool = False
    """Whether episodes of control take the place of the plans."""


def ways(replays: bool) -> dict[str, Use]:
    """The arms of an algorithm, by name.

    Args:
        replays: whether the algorithm has a replay buffer. If not, arms that replay plans are left out, and
            the encoders are compared in arms that only start at plans.
    """
    resets, replay = {"resets": 0.5}, {"replay": 0.5}
    arms = {NO_PLANS: Use(), RESETS: Use(resets)}
    if replays:
        arms |= {REPLAY: Use(replay), BOTH: Use(resets | replay)}
    best = BOTH if replays else RESETS
    encoders = {"z": "variational", "random encoder": "random", "shuffled encoder": "shuffled"}
    for label, objective in encoders.items():
        arms[f"{best} + {label}"] = Use({**arms[best].settings, "z": "augment"}, objective)
    cloning = {"clone": 2000}
    reverse = {**cloning, "resets": 0.5, "reset_schedule": "reverse"}
    return {**arms, CLONING: Use(cloning), REVERSE: Use(reverse), GUIDE: Use(reverse, guided=True)}


def comparisons(replays: bool) -> tuple[tuple[str, str, str], ...]:
    """What is claimed of an algorithm: text, arm, and the arm that it is compared with."""
    best = BOTH if replays else RESETS
    replay = (
        ("replaying plans helps", REPLAY, NO_PLANS),
        ("starts and replay help", BOTH, NO_PLANS),
        ("starts and replay help more than starts", BOTH, RESETS),
        ("starts and replay help more than replay", BOTH, REPLAY),
    )
    return (
        ("starting at plans helps", RESETS, NO_PLANS),
        *(replay if replays else ()),
        ("cloning plans helps", CLONING, NO_PLANS),
        ("cloning plans and starting at them helps more than cloning", REVERSE, CLONING),
        ("a guide helps", GUIDE, NO_PLANS),
        ("a guide helps more than plans that are used in the same way", GUIDE, REVERSE),
        ("z helps in addition", f"{best} + z", best),
        ("z helps more than a random encoder", f"{best} + z", f"{best} + random encoder"),
        ("z helps more than an encoder of shuffled plans", f"{best} + z", f"{best} + shuffled encoder"),
    )


def uses(budget: str, grid: Builder) -> Study:
    """Compare ways to use plans, on four tasks with the sparse reward, with SAC and with TRPO.

    A task of your own replaces the four tasks. The budget smoke has one task and one algorithm.
    """
    tasks, algos = (grid.task,) if grid.task else TASK_NAMES, ALGOS
    if budget == "smoke":  # a task and an algorithm are enough to see that it works
        tasks, algos = tasks[:1], algos[:1]
    panels = [(task, algo) for algo in algos for task in tasks]
    arms = tuple(arm for task, algo in panels for arm in _arms(task, algo, grid))
    names = {arm.name for arm in arms}
    claims = (claim for task, algo in panels for claim in _claims(task, algo))
    return Study(
        "uses",
        budget,
        "Which ways to use plans help, and does z help in addition?",
        arms,
        tuple(claim for claim in claims if claim.arm in names),
        (
            *NOTES,
            *(
                f"{find_task(x).name} has no guide: its goal is not a state."
                for x in tasks
                if not _is_plant(x)
            ),
        ),
        evaluated=True,
    )


def _arms(task: str | Task, algo: str, grid: Builder) -> Iterator[Arm]:
    algorithm = find_algorithm(algo, "modern")
    replays = getattr(algorithm, "replays", False)
    budget = replace(grid.budget, steps=round(grid.budget.steps * SAC_STEPS)) if replays else grid.budget
    grid = replace(grid, budget=budget, seed=FIRST_SEED)
    seen = grid.plans_for(task, NUM_PLANS)  # from which embeddings learn
    plans = grid.plans(find_task(task).problem or seen.problem, NUM_PLANS)
    fit = grid.fit(seen, PRESETS["modern"])
    guide = grid.guide(task, plans, fit, ControlConfig(follow_s=FOLLOW_S))
    for label, use in ways(replays).items():
        if use.guided and not _is_plant(task):
            continue
        demos = guide if use.guided else plans if use.settings else None
        fits = [grid.fit(seen, PRESETS["modern"].with_objective(use.objective))] if use.objective else []
        config = _config(task, algorithm, use, budget.steps)
        yield grid.arm(panel_of(task, algo), label, task, config, fits, demos=demos)


def _config(task: str | Task, algorithm: Algorithm, use: Use, steps: int) -> TrainConfig:
    if getattr(algorithm, "replays", False):
        algorithm = with_settings(algorithm, hidden=SAC_HIDDEN, critic_hidden=SAC_HIDDEN)
    elif "clone" in use.settings:
        low, high = control_bounds(*find_task(task).compile())
        algorithm = with_settings(
            algorithm, initial_std=round(CLONED_STD * float(np.mean(high - low)) / 2, 6)
        )
    has_angles = bool(find_task(task).sin_cos_columns)
    config = TrainConfig(algorithm, obs="trig" if has_angles else "raw", reward="sparse", steps=steps)
    return replace(config, **use.settings, eval_every=max(1, config.iterations // EVALUATIONS))


def _is_plant(task: str | Task) -> bool:
    """Whether the task has a goal to which control can steer."""
    try:
        Plant.find(task)
    except UsageError:
        return False
    return True


def _claims(task: str | Task, algo: str) -> Iterator[Claim]:
    margin = MARGIN * find_task(task).horizon
    for text, arm, other in comparisons(getattr(find_algorithm(algo), "replays", False)):
        yield better(panel_of(task, algo), text, arm, other, margin)
