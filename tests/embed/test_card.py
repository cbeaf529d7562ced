import re
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.embed.about import About, ObjectiveSummary, TrainingSettings
from planspace.embed.card import METRICS, model_card
from planspace.embed.config import PRESETS
from planspace.embed.embedding import Embedding
from planspace.embed.geometry import Geometry
from planspace.embed.inputs import Inputs
from planspace.seams import plain_settings

SECTIONS = ["How to use it", "Inputs", "Training", "Geometry on the test split", "Limits", "Versions"]
GEOMETRY = Geometry(0.88, 0.253, 0.0737, 0.966, 0.149, 0.154, 0.0977, 2.218, 3, 0.237, 48)


def bare(form: Any = "trig", names: tuple[str, ...] = ("x", "theta"), unit: str = "m") -> Embedding:
    num = 3 if form == "trig" else 2
    inputs = Inputs(names, (unit, "rad"), (1,), form, np.zeros(num), np.ones(num))
    layer = ([np.zeros((4, num))], [np.zeros(4)])
    return Embedding(inputs, layer, ([np.zeros((2 * num, 2))], [np.zeros(2 * num)]), 0.2)


def about(**changes: Any) -> About:
    """What `fit_embedding` would write."""
    test = asdict(GEOMETRY)
    fit = plain_settings(PRESETS["modern"]) | {"steps": 12_345, "batch": 678}
    known = About(
        preset="modern",
        seed=7,
        settings=TrainingSettings("d160b9", (6, 7, 8), split_seed=5, fit=fit),
        objective=None,
        problem="cartpole-swingup",
        split={"train": tuple(range(40)), "validation": (40, 41), "test": (42, 43, 44)},
        metrics={"train": {}, "validation": {}, "test": test},
        intervals={"test": {"straightness": (0.861, 0.893)}},
        metrics_raw_state=asdict(replace(GEOMETRY, straightness=0.127)),
        metrics_constant=asdict(replace(GEOMETRY, straightness=0.0, decoded_error=float("nan"))),
        metrics_of_seeds={6: test, 7: {**test, "midpoint_error": 0.061}, 8: test},
        versions={"planspace": "0.1.0", "mujoco": "3.17.0"},
    )
    return replace(known, **changes)


def sections(card: str) -> list[str]:
    return re.findall(r"^## (.*)$", card, flags=re.MULTILINE)


def row(card: str, first: str) -> list[str]:
    """The cells of the table row whose first cell is this."""
    (line,) = [line for line in card.splitlines() if line.startswith(f"| {first} |")]
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def test_a_card_contains_everything_about_the_training() -> None:
    embedding = replace(bare(), about=about())
    card = model_card(embedding)
    assert card.startswith("# Plan-space embedding of `cartpole-swingup`\n")
    assert sections(card) == SECTIONS
    assert embedding.hash in card
    assert "preset `modern`, objective `variational` (linearity " in card
    assert "- seeds 6, 7, 8; 7 is selected: the lowest midpoint error on the validation split" in card
    assert "0.061 to 0.074" in card
    assert "- 12,345 optimiser steps of 678 triplets" in card
    assert "- 45 demonstrations of the problem `cartpole-swingup`, SHA-256 of their content `d160b9`" in card
    assert "40 train, 2 validation, 3 test (split seed 5)" in card
    assert "the 48 demonstrations of the test split" in card
    assert "planspace 0.1.0, mujoco 3.17.0" in card


def test_weights_of_zero_are_not_listed() -> None:
    objective = {"name": "variational", "linearity": 2.0, "prior": 0.25, "distance": 0.0, "whole": True}
    settings = TrainingSettings("d160b9", (3,), split_seed=0, fit={"objective": objective})
    card = model_card(replace(bare(), about=about(settings=settings)))
    assert "objective `variational` (linearity 2, prior 0.25)\n" in card


def test_the_geometry_table_by_hand() -> None:
    card = model_card(replace(bare(), about=about()))
    assert row(card, "metric") == ["metric", "z [95 % interval]", "raw state", "constant z", "ideal"]
    assert row(card, "straightness") == ["straightness", "0.880 [0.861, 0.893]", "0.127", "0.000", "1"]
    assert row(card, "active dimensions of z") == ["active dimensions of z", "3", "3", "3", "all"]
    assert row(card, "decoded error") == ["decoded error", "0.237", "0.237", "-", "0"]


def test_each_metric_has_a_row() -> None:
    assert set(METRICS) == {field.name for field in fields(Geometry)} - {"num_demos"}


def test_without_about_a_card_has_the_other_sections() -> None:
    card = model_card(bare())
    assert sections(card) == ["How to use it", "Inputs", "Limits"]
    assert card.startswith("# Plan-space embedding\n")
    assert "None" not in card and "nan" not in card


def test_demonstrations_without_a_problem() -> None:
    card = model_card(replace(bare(), about=about(problem=None)))
    assert sections(card) == SECTIONS
    assert "None" not in card


def test_inputs_as_a_table() -> None:
    card = model_card(bare("trig", unit=""))
    assert row(card, "0") == ["0", "`x`", "not known", "no"]
    assert row(card, "1") == ["1", "`theta`", "rad", "yes"]
    assert "replaced by its sine and cosine" in card
    assert "one full turn later are different states" in model_card(bare("raw"))


def test_special_characters_in_names_are_escaped() -> None:
    card = model_card(bare(names=("a|b", "c`\n# d <script>")))
    assert row(card, "0")[1] == r"`a\|b`"
    assert row(card, "1")[1] == "`c' # d <script>`"


def test_the_card_describes_the_objective() -> None:
    objective = ObjectiveSummary("pca", "Principal components.", closed_form=True)
    fit = {"objective": {"name": "pca"}, "steps": 100, "batch": 5}
    settings = TrainingSettings("d160b9", (3,), split_seed=0, fit=fit)
    card = model_card(replace(bare(), about=about(settings=settings, seed=3, objective=objective)))
    assert "It was trained with the objective `pca`: Principal components." in card
    assert "- in closed form\n" in card and "optimiser steps" not in card
    assert "- one seed: 3\n" in card


def test_the_card_says_how_paper_selects_the_seed() -> None:
    card = model_card(replace(bare(), about=about(preset="paper")))
    assert "7 is selected: the lowest path error on the training split, as in the paper" in card


def test_the_example_runs_in_the_folder_of_the_embedding(
    embedding_folder: Path, embedding: Embedding, monkeypatch: pytest.MonkeyPatch
) -> None:
    card = model_card(embedding)
    assert sections(card) == SECTIONS  # `fit_embedding` writes everything that the card shows
    (code,) = re.findall(r"```python\n(.*?)```", card, flags=re.DOTALL)
    monkeypatch.chdir(embedding_folder)
    scope: dict[str, Any] = {}
    exec(code, scope)
    assert scope["z"].shape == (3,)
    assert scope["far"] == pytest.approx(
        np.linalg.norm(embedding.encode(np.zeros(4)) - embedding.encode(np.ones(4)))
    )
