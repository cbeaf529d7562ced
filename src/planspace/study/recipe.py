"""The study `recipe`: how reliably can the swing-up, or a task of your own, be learned?"""

from dataclasses import replace

from planspace.embed.config import PRESETS
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.study.design import BLOCK, RAW, SWING_UP, Arm, Builder, Study, better, panel_of
from planspace.tasks.catalog import find_task
from planspace.tasks.task import Task

RECIPE_FIT = PRESETS["modern"].with_settings(linearity=2.0)
POLICIES_PER_EMBEDDING = 15
RECIPE_SEED, RECIPE_FIT_SEED = 200, 10
"""First seeds of policies and embeddings. No setting was chosen on these seeds."""


def recipe(budget: str, grid: Builder) -> Study:
    """Compare the best known arm for the swing-up with raw, sin and cos, and a random encoder.

    A task that has no sin and cos to add has no arm for them.
    """
    best, *others = arms = _arms(grid, grid.task or SWING_UP)
    name = find_task(grid.task).name if grid.task else "the swing-up"
    return Study(
        "recipe",
        budget,
        f"How reliably can {name} be learned?",
        arms,
        tuple(
            better(best.panel, f"the recipe is better than {x.label}", best.label, x.label) for x in others
        ),
        (
            "Every arm uses TRPO with the preset modern. The recipe has 15 policies per embedding, and five "
            "embeddings. No setting was chosen on these seeds. Each other arm is compared with the recipe's "
            "first seeds.",
        ),
    )


def _arms(grid: Builder, task: str | Task) -> tuple[Arm, ...]:
    panel, plans = panel_of(task, "trpo"), grid.plans_for(task)
    raw = TrainConfig(find_algorithm("trpo", "modern"))
    has_angles = bool(find_task(task).sin_cos_columns)
    trig, inputs = (replace(raw, obs="trig"), "sin/cos") if has_angles else (raw, RAW)
    trig_z, unseen = replace(trig, z="augment"), replace(grid, seed=RECIPE_SEED)
    random = grid.fits(plans, PRESETS["modern"].with_objective("random"), first=RECIPE_FIT_SEED)
    seeds = (
        POLICIES_PER_EMBEDDING * grid.budget.embeddings if grid.budget.seeds >= BLOCK else grid.budget.seeds
    )
    fits = grid.fits(plans, RECIPE_FIT, first=RECIPE_FIT_SEED)
    return (
        unseen.arm(panel, f"recipe: {inputs} + z", task, trig_z, fits, seeds),
        *((unseen.arm(panel, inputs, task, trig),) if has_angles else ()),
        unseen.arm(panel, f"{inputs} + random encoder", task, trig_z, random),
        unseen.arm(panel, RAW, task, raw),
    )
