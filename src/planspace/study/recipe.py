"""The study `recipe`: how reliably can the swing-up be learned?"""

from dataclasses import replace

from planspace.embed.config import PRESETS
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.study.design import BLOCK, RAW, SWING_UP, Builder, Study, better, panel_of

RECIPE = "recipe: sin/cos + z"
RECIPE_FIT = PRESETS["modern"].with_settings(linearity=2.0)
POLICIES_PER_EMBEDDING = 15
RECIPE_SEED, RECIPE_FIT_SEED = 200, 10
"""First seeds of policies and embeddings. No setting was chosen on these seeds."""


def recipe(budget: str, grid: Builder) -> Study:
    """Compare the best known arm for the swing-up with raw, sin and cos, and a random encoder."""
    panel, plans = panel_of(SWING_UP, "trpo"), grid.plans_for(SWING_UP)
    raw = TrainConfig(find_algorithm("trpo", "modern"))
    trig, trig_z = replace(raw, obs="trig"), replace(raw, obs="trig", z="augment")
    unseen = replace(grid, seed=RECIPE_SEED)
    random = grid.fits(plans, PRESETS["modern"].with_objective("random"), first=RECIPE_FIT_SEED)
    seeds = (
        POLICIES_PER_EMBEDDING * grid.budget.embeddings if grid.budget.seeds >= BLOCK else grid.budget.seeds
    )
    fits = grid.fits(plans, RECIPE_FIT, first=RECIPE_FIT_SEED)
    arms = (
        unseen.arm(panel, RECIPE, SWING_UP, trig_z, fits, seeds),
        unseen.arm(panel, "sin/cos", SWING_UP, trig),
        unseen.arm(panel, "sin/cos + random encoder", SWING_UP, trig_z, random),
        unseen.arm(panel, RAW, SWING_UP, raw),
    )
    return Study(
        "recipe",
        budget,
        "How reliably can the swing-up be learned?",
        arms,
        tuple(better(panel, f"the recipe is better than {x.label}", RECIPE, x.label) for x in arms[1:]),
        (
            "Every arm uses TRPO with the preset modern. The recipe has 15 policies per embedding, and five "
            "embeddings. No setting was chosen on these seeds. Each other arm is compared with the recipe's "
            "first seeds.",
        ),
    )
