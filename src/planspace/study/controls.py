"""The study `controls`: why does an embedding help? Each arm tests another explanation."""

from collections.abc import Iterator
from dataclasses import replace

from planspace.embed.config import PRESETS
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.study.design import RAW, SWING_UP, Arm, Builder, Claim, Study, better, panel_of
from planspace.tasks.catalog import find_task
from planspace.tasks.task import Task

CONTROLLED: tuple[tuple[str | Task, str], ...] = (
    (SWING_UP, "trpo"),
    (SWING_UP, "ppo"),
    ("reacher-raw", "trpo"),
    ("reacher-raw", "ppo"),
)
Z, TRIG, TRIG_Z = "raw + z", "raw + sin/cos", "raw + sin/cos + z"
OBJECTIVES: dict[str, str] = {
    "raw + random encoder": "random",
    "raw + auto-encoder": "vae",
    "raw + shuffled": "shuffled",
    "raw + principal components": "pca",
    "raw + E2C": "e2c",
}
NORMALISED, WIDE, LAYER_NORM = "raw, normalised", "raw, wider network", "raw, layer norm"
TO_POLICY, TO_CRITIC = "raw + z to the policy", "raw + z to the critic"
NUM_OF: dict[str, int] = {"random": 3, "pca": 1}
"""Number of embedding seeds per objective, if it differs from the budget's."""


def controls(budget: str, grid: Builder) -> Study:
    """Compare z with other observations, encoders and networks, on two tasks and with two algorithms.

    A task of your own replaces the two tasks, and the budget smoke has the first of them only. A task that
    has no sin and cos to add has no arms for them.
    """
    controlled = CONTROLLED[:2] if budget == "smoke" else CONTROLLED  # a task is enough to see that it works
    panels = [(grid.task, algo) for algo in ("trpo", "ppo")] if grid.task else controlled
    arms = tuple(arm for task, algo in panels for arm in _arms(task, algo, grid))
    names = {arm.name for arm in arms}
    claims = (claim for task, algo in panels for claim in _claims(panel_of(task, algo)))
    return Study(
        "controls",
        budget,
        "Why does an embedding help?",
        arms,
        tuple(claim for claim in claims if {claim.arm, claim.other} <= names),
        (
            "z has 3 numbers in every arm. Embeddings use the preset modern except for the objective; "
            "policies use the preset paper. The policies of an arm use five embedding seeds in turn (the "
            "random encoder has three, principal components have one).",
        ),
    )


def _arms(task: str | Task, algo: str, grid: Builder) -> Iterator[Arm]:
    panel, plans, base = panel_of(task, algo), grid.plans_for(task), TrainConfig(find_algorithm(algo))
    augment, fits = replace(base, z="augment"), grid.fits(plans, PRESETS["modern"])
    yield grid.arm(panel, RAW, task, base)
    has_angles = bool(find_task(task).sin_cos_columns)
    if has_angles:
        yield grid.arm(panel, TRIG, task, replace(base, obs="trig"))
    yield grid.arm(panel, Z, task, augment, fits)
    if has_angles:
        yield grid.arm(panel, TRIG_Z, task, replace(augment, obs="trig"), fits)
    yield grid.arm(panel, NORMALISED, task, base.with_hyperparameters(normalise_obs=True))
    for label, objective in OBJECTIVES.items():
        config = PRESETS["modern"].with_objective(objective)
        yield grid.arm(panel, label, task, augment, grid.fits(plans, config, NUM_OF.get(objective, 0)))
    yield grid.arm(panel, WIDE, task, base.with_hyperparameters(match_z=PRESETS["modern"].z_dim))
    yield grid.arm(panel, LAYER_NORM, task, base.with_hyperparameters(layer_norm=True))
    yield grid.arm(panel, TO_POLICY, task, replace(augment, z_to="policy"), fits)
    yield grid.arm(panel, TO_CRITIC, task, replace(augment, z_to="critic"), fits)


def _claims(panel: str) -> Iterator[Claim]:
    yield better(panel, "z helps", Z, RAW)
    yield better(panel, "sin and cos help", TRIG, RAW)
    yield better(panel, "z helps more than sin and cos", Z, TRIG)
    yield better(panel, "z helps in addition to sin and cos", TRIG_Z, TRIG)
    yield better(panel, "z helps more than normalised observations", Z, NORMALISED)
    for label in OBJECTIVES:
        yield better(panel, f"z helps more than {label.removeprefix('raw + ')}", Z, label)
    yield better(panel, "z helps more than a wider network", Z, WIDE)
    yield better(panel, "z helps more than layer norm", Z, LAYER_NORM)
    yield better(panel, "z helps the policy", TO_POLICY, RAW)
    yield better(panel, "z helps the critic", TO_CRITIC, RAW)
