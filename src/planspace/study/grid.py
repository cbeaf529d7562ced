"""The studies and budgets by name."""

from collections.abc import Callable

from planspace.errors import UsageError, unknown
from planspace.study.controls import controls
from planspace.study.demonstrations import demos
from planspace.study.design import BLOCK, Budget, Builder, Study
from planspace.study.paper import paper
from planspace.study.recipe import recipe
from planspace.study.shaping import shaping

BUDGETS: dict[str, Budget] = {
    "smoke": Budget(steps=12_000, seeds=2, plans=12, embeddings=2, restarts=1, fit_steps=300),
    "half": Budget(steps=1_000_000),
    "full": Budget(steps=2_000_000),
    "paper": Budget(steps=8_000_000),
}


STUDIES: dict[str, Callable[[str, Builder], Study]] = {
    "paper": paper,
    "controls": controls,
    "demos": demos,
    "shaping": shaping,
    "recipe": recipe,
}


def make_study(name: str, budget: str, *, seeds: int = 0) -> Study:
    """Make a study.

    Args:
        name: a key of `STUDIES`.
        budget: a key of `BUDGETS`.
        seeds: seeds per arm; 0 uses the study's number.

    Raises:
        UsageError: the study or budget is unknown, or `seeds` is not a multiple of `BLOCK`.
    """
    if name not in STUDIES:
        raise unknown("study", name, STUDIES)
    if budget not in BUDGETS:
        raise unknown("budget", budget, BUDGETS)
    if seeds % BLOCK or seeds < 0:
        raise UsageError(f"`--seeds` must be a positive multiple of {BLOCK}, got {seeds}.")
    return STUDIES[name](budget, Builder(BUDGETS[budget], seeds))
