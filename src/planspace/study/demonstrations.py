"""The study `demos`: which demonstrations help? It varies their source and number, and the inputs."""

from collections.abc import Iterator
from dataclasses import replace

from planspace.embed.config import PRESETS
from planspace.embed.inputs import InputType
from planspace.rl.config import TrainConfig
from planspace.study.design import BLOCK, RAW, SWING_UP, Arm, Builder, Claim, Study, better, panel_of
from planspace.study.unit import PlansUnit

WINDING, SST, POLISHED = "with winding", "SST", "SST + polish"
COUNTS = (20, 100, 500)
INPUTS: dict[str, InputType] = {"raw inputs": "raw", "sin/cos inputs": "trig"}
POLICIES_PER_EMBEDDING = 5


def demos(budget: str, grid: Builder) -> Study:
    """Train five embeddings on each set of demonstrations, and five policies on each embedding."""
    panels: dict[str, InputType] = {
        f"{panel_of(SWING_UP, 'trpo')}, {label}": inputs for label, inputs in INPUTS.items()
    }
    return Study(
        "demos",
        budget,
        "Which demonstrations help?",
        tuple(arm for panel, inputs in panels.items() for arm in _arms(panel, inputs, grid)),
        tuple(claim for panel in panels for claim in _claims(panel)),
        ("Policies observe raw + z. Seed s uses embedding s modulo five: five policies per embedding.",),
    )


def _arms(panel: str, inputs: InputType, grid: Builder) -> Iterator[Arm]:
    base, config = TrainConfig(), replace(PRESETS["modern"], inputs=inputs)
    seeds = (
        POLICIES_PER_EMBEDDING * grid.budget.embeddings if grid.budget.seeds >= BLOCK else grid.budget.seeds
    )
    yield grid.arm(panel, RAW, SWING_UP, base, seeds=seeds)
    for source in (WINDING, SST, POLISHED):
        for count in COUNTS:
            fits = grid.fits(_plans_of(source, count, grid), config)
            yield grid.arm(panel, f"{source}, {count}", SWING_UP, replace(base, z="augment"), fits, seeds)


def _plans_of(source: str, count: int, grid: Builder) -> PlansUnit:
    if source == WINDING:
        return replace(grid.plans(SWING_UP, count), source="2020", settings=())
    settings = {"polish_max_iterations": 0} if source == SST else {}
    return grid.plans(SWING_UP, count, **settings)


def _claims(panel: str) -> Iterator[Claim]:
    text = "plans that reach their goal help more than plans with winding"
    yield better(panel, text, f"{SST}, 500", f"{WINDING}, 500")
    yield better(panel, "polish helps", f"{POLISHED}, 500", f"{SST}, 500")
    for count in COUNTS[1:]:
        text = f"{count} demonstrations help more than 20"
        yield better(panel, text, f"{POLISHED}, {count}", f"{POLISHED}, 20")
    yield better(panel, "20 demonstrations help", f"{POLISHED}, 20", RAW)
    yield better(panel, "plans with winding help", f"{WINDING}, 500", RAW)
