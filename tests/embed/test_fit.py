from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed import fit as module
from planspace.embed.embedding import Embedding
from planspace.embed.fit import CHUNK, PRESETS, fit
from planspace.errors import PlanspaceError
from planspace.store import file_hash

from ..conftest import QUICK_FIT


def test_training_makes_plans_straighter_than_the_state_and_the_untrained_map(
    demos: Demos, tmp_path: Path
) -> None:
    config = replace(PRESETS["modern"], steps=1500, batch=128)
    trained = fit(demos, tmp_path / "a", config=config, num_seeds=2, seed=0).about
    untrained = fit(demos, tmp_path / "b", config=replace(config, steps=1), num_seeds=2, seed=0).about
    z, raw = trained["metrics"]["train"], trained["metrics_raw_state"]
    assert z["straightness"] > 1.3 * raw["straightness"]
    assert z["midpoint_error"] < untrained["metrics"]["train"]["midpoint_error"]
    assert z["decoded_error"] < 0.6 * untrained["metrics"]["train"]["decoded_error"]
    assert z["active_dims"] == 3


def test_interrupted_training_ends_bit_for_bit_as_undisturbed(
    demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(QUICK_FIT, steps=3 * CHUNK, batch=16)
    fit(demos, tmp_path / "whole", config=config, num_seeds=2, seed=3)
    run_chunk, calls = module._run_chunk, []

    def interrupted(*args: object):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return run_chunk(*args)  # pyright: ignore

    monkeypatch.setattr(module, "_run_chunk", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fit(demos, tmp_path / "cut", config=config, num_seeds=2, seed=3)
    fit(demos, tmp_path / "cut", config=config, num_seeds=2, seed=3)
    assert len(calls) == 4  # one chunk done, one cut off, and the two that were left: none twice
    name = "embedding.safetensors"
    assert file_hash(tmp_path / "cut" / name) == file_hash(tmp_path / "whole" / name)


def test_a_seed_does_not_depend_on_those_beside_it(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, steps=50, batch=16)
    alone = fit(demos, tmp_path / "alone", config=config, num_seeds=1, seed=1, split_seed=0)
    beside = fit(demos, tmp_path / "beside", config=config, num_seeds=2, seed=0)
    a = alone.about["metrics_of_seeds"]["1"]["straightness"]
    b = beside.about["metrics_of_seeds"]["1"]["straightness"]
    assert a == pytest.approx(b, rel=1e-3)  # batched arithmetic rounds otherwise, no more


def test_the_paper_preset_sees_raw_numbers_and_chooses_by_path_error(demos: Demos, tmp_path: Path) -> None:
    config = replace(PRESETS["paper"], steps=100)
    embedding = fit(demos, tmp_path / "e", config=config, num_seeds=3, seed=0)
    assert embedding.inputs.form == "raw"
    assert (embedding.inputs.mean == 0).all() and (embedding.inputs.deviation == 1).all()
    assert embedding.about["seed"] in (0, 1, 2)
    assert PRESETS["paper"].linearity == 0.5 and PRESETS["paper"].batch == 50


def test_modern_never_keeps_a_collapsed_seed_beside_a_whole_one(embedding: Embedding, demos: Demos) -> None:
    weights, biases = embedding.encoder
    last = weights[-1].copy()
    last[0] = 0.0  # the first dimension's mean no longer depends on the state
    collapsed = replace(embedding, encoder=([*weights[:-1], last], biases))
    split = demos.split(0)
    chosen, validation = module._choose([collapsed, embedding], demos, split, PRESETS["modern"])
    assert chosen == 1
    assert [g.active_dims for g in validation] == [2, 3]


def test_finished_training_is_returned_and_other_settings_refused(
    demos: Demos, embedding_folder: Path
) -> None:
    before = file_hash(embedding_folder / "embedding.json")
    fit(demos, embedding_folder, config=QUICK_FIT, num_seeds=2, seed=0)
    assert file_hash(embedding_folder / "embedding.json") == before
    with pytest.raises(PlanspaceError, match=r"fit.z_dim was 3, now 10"):
        fit(demos, embedding_folder, config=replace(QUICK_FIT, z_dim=10), num_seeds=2, seed=0)


def test_divergence_is_reported_with_its_seed(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, learning_rate=1e12, clip_norm=None)
    with pytest.raises(PlanspaceError, match="training diverged between steps 0 and 300 for seed 5"):
        fit(demos, tmp_path / "e", config=config, num_seeds=1, seed=5)
    assert not (tmp_path / "e" / "embedding.json").exists()


def test_z_of_any_size(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, steps=20, z_dim=10)
    embedding = fit(demos, tmp_path / "e", config=config, num_seeds=1, seed=0)
    assert embedding.encode(np.zeros(4)).shape == (10,)
