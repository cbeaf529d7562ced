"""The studies that go beyond the paper: controls, demonstrations, shaping, and the best recipe."""

from collections.abc import Iterator
from dataclasses import replace

from planspace.embed.config import PRESETS
from planspace.embed.inputs import InputType
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import ShapingType, TrainConfig
from planspace.study.design import BLOCK, Arm, Builder, Claim, Study, panel_of
from planspace.study.paper import RAW
from planspace.study.unit import PlansUnit
from planspace.tasks.observation_types import RewardType

SWING_UP = "cartpole-swingup"

# --- controls -------------------------------------------------------------------------------------------

CONTROLLED: tuple[tuple[str, str], ...] = (
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
"""Embeddings that policies take in turn, where they are not as many as the budget says."""


def controls(budget: str, grid: Builder) -> Study:
    """What else could z's help come from? An arm for each answer."""
    return Study(
        "controls",
        budget,
        "Why does an embedding help?",
        tuple(arm for task, algo in CONTROLLED for arm in _control_arms(task, algo, grid)),
        tuple(claim for task, algo in CONTROLLED for claim in _control_claims(panel_of(task, algo))),
        (
            "z has 3 numbers everywhere; embeddings are of the preset modern, their objective apart, and "
            "policies of the preset paper. Policies take five seeds of an embedding in turn (three of the "
            "random encoder; principal components have none).",
        ),
    )


def _control_arms(task: str, algo: str, grid: Builder) -> Iterator[Arm]:
    panel, plans, base = panel_of(task, algo), grid.plans_for(task), TrainConfig(find_algorithm(algo))
    augment, fits = replace(base, z="augment"), grid.fits(plans, PRESETS["modern"])
    yield grid.arm(panel, RAW, task, base)
    yield grid.arm(panel, TRIG, task, replace(base, obs="trig"))
    yield grid.arm(panel, Z, task, augment, fits)
    yield grid.arm(panel, TRIG_Z, task, replace(augment, obs="trig"), fits)
    yield grid.arm(panel, NORMALISED, task, base.with_hyperparameters(normalise_obs=True))
    for label, objective in OBJECTIVES.items():
        config = PRESETS["modern"].with_objective(objective)
        yield grid.arm(panel, label, task, augment, grid.fits(plans, config, NUM_OF.get(objective, 0)))
    yield grid.arm(panel, WIDE, task, base.with_hyperparameters(match_z=PRESETS["modern"].z_dim))
    yield grid.arm(panel, LAYER_NORM, task, base.with_hyperparameters(layer_norm=True))
    yield grid.arm(panel, TO_POLICY, task, replace(augment, z_to="policy"), fits)
    yield grid.arm(panel, TO_CRITIC, task, replace(augment, z_to="critic"), fits)


def _control_claims(panel: str) -> Iterator[Claim]:
    yield _better(panel, "z helps", Z, RAW)
    yield _better(panel, "sin and cos help", TRIG, RAW)
    yield _better(panel, "z helps more than sin and cos", Z, TRIG)
    yield _better(panel, "z helps beyond sin and cos", TRIG_Z, TRIG)
    yield _better(panel, "z helps more than normalising what is observed", Z, NORMALISED)
    for label in OBJECTIVES:
        yield _better(panel, f"z helps more than {label.removeprefix('raw + ')}", Z, label)
    yield _better(panel, "z helps more than a wider network", Z, WIDE)
    yield _better(panel, "z helps more than layer norm", Z, LAYER_NORM)
    yield _better(panel, "z helps the policy", TO_POLICY, RAW)
    yield _better(panel, "z helps the critic", TO_CRITIC, RAW)


def _better(panel: str, text: str, arm: str, other: str) -> Claim:
    return Claim(f"{panel}: {text}", "ours", "final", f"{panel}/{arm}", f"{panel}/{other}")


# --- demos ----------------------------------------------------------------------------------------------

WOUND, SST, POLISHED = "wound up", "SST", "SST + polish"
COUNTS = (20, 100, 500)
INPUTS: dict[str, InputType] = {"raw inputs": "raw", "sin/cos inputs": "trig"}
EACH = 5
"""Policies for each embedding."""


def demos(budget: str, grid: Builder) -> Study:
    """One preset on every set of demonstrations, five embeddings each, five policies for each of them."""
    panels: dict[str, InputType] = {
        f"{panel_of(SWING_UP, 'trpo')}, {inputs}": form for inputs, form in INPUTS.items()
    }
    return Study(
        "demos",
        budget,
        "What must demonstrations be like?",
        tuple(arm for panel, form in panels.items() for arm in _demo_arms(panel, form, grid)),
        tuple(claim for panel in panels for claim in _demo_claims(panel)),
        ("Policies observe raw + z. Seed s takes embedding s modulo five: five policies for each of five.",),
    )


def _demo_arms(panel: str, form: InputType, grid: Builder) -> Iterator[Arm]:
    base, config = TrainConfig(), replace(PRESETS["modern"], inputs=form)
    seeds = EACH * grid.budget.embeddings if grid.budget.seeds >= BLOCK else grid.budget.seeds
    yield grid.arm(panel, RAW, SWING_UP, base, seeds=seeds)
    for source in (WOUND, SST, POLISHED):
        for count in COUNTS:
            fits = grid.fits(_plans_of(source, count, grid), config)
            yield grid.arm(panel, f"{source}, {count}", SWING_UP, replace(base, z="augment"), fits, seeds)


def _plans_of(source: str, count: int, grid: Builder) -> PlansUnit:
    if source == WOUND:
        return replace(grid.plans(SWING_UP, count), source="2020", settings=())
    settings = {"polish_max_iterations": 0} if source == SST else {}
    return grid.plans(SWING_UP, count, **settings)


def _demo_claims(panel: str) -> Iterator[Claim]:
    text = "plans that reach their goal help more than wound-up ones"
    yield _better(panel, text, f"{SST}, 500", f"{WOUND}, 500")
    yield _better(panel, "polish helps", f"{POLISHED}, 500", f"{SST}, 500")
    for count in COUNTS[1:]:
        text = f"{count} demonstrations help more than 20"
        yield _better(panel, text, f"{POLISHED}, {count}", f"{POLISHED}, 20")
    yield _better(panel, "20 demonstrations help", f"{POLISHED}, 20", RAW)
    yield _better(panel, "wound-up demonstrations help", f"{WOUND}, 500", RAW)


# --- shaping --------------------------------------------------------------------------------------------

UNSHAPED, SHAPED_BY_Z = "unshaped", "shaped by z"
SHAPINGS: dict[str, ShapingType] = {UNSHAPED: "none", SHAPED_BY_Z: "z", "shaped by raw distance": "raw"}
REWARDS: tuple[RewardType, ...] = ("dense", "sparse")
SHAPING_SCALE = 100.0
"""What the way from a mean start to the goal is worth: a seventh of what lies between idle and solved."""


def shaping(budget: str, grid: Builder) -> Study:
    """Potential-based shaping by distance in z, by raw distance, and none; dense and sparse reward."""
    panels: dict[str, RewardType] = {f"{panel_of(SWING_UP, 'trpo')}, {r} reward": r for r in REWARDS}
    return Study(
        "shaping",
        budget,
        "Does distance in z say which way to go?",
        tuple(arm for panel, reward in panels.items() for arm in _shaping_arms(panel, reward, grid)),
        tuple(
            _better(panel, f"{SHAPED_BY_Z} is better than {other}", SHAPED_BY_Z, other)
            for panel in panels
            for other in SHAPINGS
            if other != SHAPED_BY_Z
        ),
        ("Policies observe raw + sin/cos. Returns are the task's own, without what the shaping pays.",),
    )


def _shaping_arms(panel: str, reward: RewardType, grid: Builder) -> Iterator[Arm]:
    fits = grid.fits(grid.plans_for(SWING_UP), PRESETS["modern"])
    plain = TrainConfig(obs="trig", reward=reward)
    for label, form in SHAPINGS.items():
        shaped = replace(plain, shaping=form, shaping_scale=SHAPING_SCALE)
        yield grid.arm(
            panel, label, SWING_UP, plain if form == "none" else shaped, fits if form == "z" else ()
        )


# --- recipe ---------------------------------------------------------------------------------------------

RECIPE = "recipe: sin/cos + z"
RECIPE_FIT = PRESETS["modern"].with_settings(linearity=2.0)
RECIPE_EACH = 15
"""Policies for each of the embeddings."""
RECIPE_SEED, RECIPE_FIT_SEED = 200, 10
"""Seeds that nothing was chosen on: neither the embedding's settings nor the policies'."""


def recipe(budget: str, grid: Builder) -> Study:
    """The best that was found for the swing-up, beside raw, sin and cos, and a random encoder."""
    panel, plans = panel_of(SWING_UP, "trpo"), grid.plans_for(SWING_UP)
    raw = TrainConfig(find_algorithm("trpo", "modern"))
    trig, trig_z = replace(raw, obs="trig"), replace(raw, obs="trig", z="augment")
    unseen = replace(grid, seed=RECIPE_SEED)
    random = grid.fits(plans, PRESETS["modern"].with_objective("random"), first=RECIPE_FIT_SEED)
    seeds = RECIPE_EACH * grid.budget.embeddings if grid.budget.seeds >= BLOCK else grid.budget.seeds
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
        "How surely can the swing-up be learned?",
        arms,
        tuple(_better(panel, f"the recipe is better than {x.label}", RECIPE, x.label) for x in arms[1:]),
        (
            "TRPO of the preset modern in every arm; 15 policies for each of the recipe's five embeddings. "
            "Nothing was chosen on these seeds. Each other arm is compared with the recipe's first seeds.",
        ),
    )
