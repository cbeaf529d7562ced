"""A user's objective, compared with a shipped one with the same loss; and invalid objectives."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed.config import PRESETS
from planspace.embed.fit import fit_embedding
from planspace.embed.objective import Objective, as_objective
from planspace.embed.saved_embedding import load_embedding
from planspace.errors import PlanspaceError, UsageError

from ..strangers.own_objective import Contrast, midpoint_loss

CONFIG = replace(PRESETS["modern"], steps=100, batch=32, hidden=(16, 16))
PAGE = r"[Ss]ee docs/howto/own-objective.md\."


@pytest.mark.nightly
def test_a_function_with_the_loss_of_a_shipped_objective_gives_the_same_embedding(demos: Demos) -> None:
    ours = fit_embedding(demos, "direct", config=CONFIG, num_seeds=2, verbose=False)
    own = fit_embedding(demos, midpoint_loss, config=CONFIG, num_seeds=2, verbose=False)
    np.testing.assert_allclose(own.encode(demos.states), ours.encode(demos.states), atol=1e-3)
    assert own.require_about().seed == ours.require_about().seed
    objective = own.require_about().objective
    assert objective is not None and objective.summary.startswith(
        "The distance between x_t and the state decoded"
    )


@pytest.mark.slow
def test_a_class_draws_its_samples_and_its_settings_and_terms_are_recorded(
    demos: Demos, tmp_path: Path
) -> None:
    folder = tmp_path / "embedding"
    own = fit_embedding(demos, Contrast(margin=0.5), config=CONFIG, out=folder, num_seeds=1)
    saved = own.require_about().settings.fit["objective"]
    assert saved["name"] == "tests.strangers.own_objective:Contrast" and saved["margin"] == 0.5
    assert len(saved["source_sha256"]) == 64
    row = json.loads((folder / "log.jsonl").read_text().splitlines()[-1])
    assert {"bound", "pull", "push"} <= row.keys()
    assert max(row["push"]) <= 0.5**2  # the largest cost with this margin; more with the default
    # the loss does not use the decoder, so training fits the decoder to z
    assert own.require_about().metrics["train"]["decoded_error"] < 1.0
    assert load_embedding(folder).hash == own.hash


@pytest.mark.nightly
def test_a_changed_setting_of_an_own_objective_is_refused(demos: Demos, tmp_path: Path) -> None:
    fit_embedding(demos, Contrast(), config=replace(CONFIG, steps=5), out=tmp_path / "e", num_seeds=1)
    with pytest.raises(PlanspaceError, match=r"fit.objective.margin was 3.0, now 2.0"):
        fit_embedding(demos, Contrast(2.0), config=replace(CONFIG, steps=5), out=tmp_path / "e", num_seeds=1)


def vector(model, sample, *, key):
    return model.encode(sample.x[0]).mu


def text_terms(model, sample, *, key):
    return jnp.sum(sample.w), {"name": "text"}


def broken(model, sample, *, key):
    return model.encoder(sample.x[0])


def no_key(model, sample):
    return jnp.sum(sample.w)


@dataclass
class Mutable(Objective):
    def loss(self, model, sample, *, key):
        return 0.0


@dataclass(frozen=True)
class OneDraw(Contrast):
    def draw_triplets(self, source):
        return source.standard().rows[:, :2]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            "directt",
            r"unknown objective 'directt'\. Did you mean 'direct'\?.* To write an Objective",
        ),
        (Contrast, "expected an Objective, got the class Contrast: pass an instance"),
        (Mutable(), "an Objective must be hashable, got .*: make it a frozen dataclass"),
        (no_key, r"called as loss\(model, sample, key=key\); .* got an unexpected keyword argument 'key'"),
        (vector, r"`loss` of an Objective must return a scalar, or .*, got an array of shape \(3,\)"),
        (text_terms, "`loss` of an Objective must return a scalar for the term 'name', got 'text'"),
        (
            broken,
            "the loss of the Objective tests.embed.test_own_objective:broken failed on its first sample: "
            "AttributeError: .*encoder",
        ),
        (OneDraw(), "`draw_triplets` of an Objective must return Triplets, got .*"),
    ],
)
def test_an_invalid_objective_is_refused_before_anything_is_written(
    given: Any, message: str, demos: Demos, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=message + "(?s:.*)" + PAGE):
        fit_embedding(demos, given, config=CONFIG, out=tmp_path / "e", num_seeds=1)
    assert not (tmp_path / "e").exists()


def test_an_object_without_the_methods_is_refused() -> None:
    with pytest.raises(UsageError, match="An Objective needs the methods .*loss.*" + PAGE):
        as_objective(SimpleNamespace(loss=midpoint_loss))


@pytest.mark.slow
def test_a_loss_that_is_not_finite_at_the_first_step_is_refused(demos: Demos) -> None:
    def loss(model, sample, *, key):
        return jnp.log(-1.0 - model.encode(sample.x[0]).mu[0] ** 2)

    with pytest.raises(
        PlanspaceError,
        match=r"must be finite at the first step, but for seed 0 it is not\..*own-objective.md",
    ):
        fit_embedding(demos, loss, config=CONFIG, num_seeds=1, verbose=False)
