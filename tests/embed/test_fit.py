import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed import fit as module
from planspace.embed import training
from planspace.embed.config import PRESETS
from planspace.embed.embedding import Embedding, load_embedding
from planspace.embed.fit import fit
from planspace.embed.training import CHUNK
from planspace.errors import PlanspaceError, UsageError
from planspace.store import file_hash, read_about, read_arrays

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
    run_steps, calls = training.run_steps, []

    def interrupted(*args: object):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return run_steps(*args)  # pyright: ignore

    monkeypatch.setattr(training, "run_steps", interrupted)
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
    paper = PRESETS["paper"]
    assert (paper.objective.linearity, paper.objective.prior, paper.batch) == (0.5, 1.0, 50)


def test_modern_never_keeps_a_collapsed_seed_beside_a_whole_one(embedding: Embedding, demos: Demos) -> None:
    weights, biases = embedding.encoder
    last = weights[-1].copy()
    last[0] = 0.0  # the first dimension's mean no longer depends on the state
    collapsed = replace(embedding, encoder=([*weights[:-1], last], biases))
    split = demos.split(0)
    chosen, validation = module.choose([collapsed, embedding], demos, split, PRESETS["modern"])
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


def test_divergence_is_caught_at_its_step_and_saved_as_before(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, learning_rate=1e12, clip_norm=None)
    with pytest.raises(PlanspaceError, match=r"diverged at step (\d+) for seed 5.*at step (\d+)\.") as caught:
        fit(demos, tmp_path / "e", config=config, num_seeds=2, seed=5)
    assert not (tmp_path / "e" / "embedding.json").exists()
    numbers = [int(n) for n in re.findall(r"at step (\d+)", str(caught.value))]
    arrays = read_arrays(tmp_path / "e" / "checkpoint" / "state.safetensors")
    assert read_about(tmp_path / "e" / "checkpoint" / "state.safetensors") == {"step": numbers[1]}
    assert numbers[1] == numbers[0] - 1 and all(np.isfinite(a).all() for a in arrays.values())
    with pytest.raises(PlanspaceError, match=f"diverged at step {numbers[0]} for seed 5"):
        fit(demos, tmp_path / "e", config=config, num_seeds=2, seed=5)  # the same again, from there


@pytest.mark.parametrize(
    "name", ["direct", "vae", "e2c", "straightening", "distance", "pca", "random", "shuffled"]
)
def test_every_objective_makes_an_embedding(demos: Demos, tmp_path: Path, name: str) -> None:
    config = replace(QUICK_FIT.changed(name=name), steps=30)
    embedding = fit(demos, tmp_path / "e", config=config, num_seeds=2, seed=0)
    assert embedding.about["settings"]["fit"]["objective"]["name"] == name
    assert np.isfinite(embedding.encode(demos.states)).all()
    assert load_embedding(tmp_path / "e").hash == embedding.hash


def test_a_random_encoder_stays_as_it_was_drawn(demos: Demos, tmp_path: Path) -> None:
    short, long = (
        fit(
            demos,
            tmp_path / str(n),
            config=replace(QUICK_FIT.changed(name="random"), steps=n),
            num_seeds=1,
            seed=0,
        )
        for n in (1, 200)
    )
    for a, b in zip(short.encoder[0], long.encoder[0], strict=True):
        np.testing.assert_array_equal(a, b)
    assert long.about["metrics"]["train"]["decoded_error"] < short.about["metrics"]["train"]["decoded_error"]


def test_named_columns_alone_are_read(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, steps=30, columns=("hingevel", "hinge"))
    embedding = fit(demos, tmp_path / "e", config=config, num_seeds=1, seed=0)
    assert embedding.inputs.names == ("hingevel", "hinge")
    assert embedding.inputs.circular_columns == (1,)
    assert embedding.about["metrics"]["test"]["num_demos"] == 1
    with pytest.raises(PlanspaceError, match="'elbow' is missing"):
        fit(demos, tmp_path / "f", config=replace(config, columns=("elbow",)), num_seeds=1, seed=0)


def test_curves_split_and_card_are_kept(embedding_folder: Path, demos: Demos) -> None:
    rows = [json.loads(line) for line in (embedding_folder / "log.jsonl").read_text().splitlines()]
    assert rows[-1]["step"] == QUICK_FIT.steps
    assert len(rows[-1]["bound"]) == len(rows[-1]["path_error"]) == len(rows[-1]["midpoint_error"]) == 2
    about = load_embedding(embedding_folder).about
    assert {name: len(part) for name, part in about["split"].items()} == {
        "train": 10,
        "validation": 1,
        "test": 1,
    }
    assert about["metrics"]["validation"]["midpoint_error"] == pytest.approx(
        about["metrics_of_seeds"][str(about["seed"])]["midpoint_error"]
    )
    assert set(about["intervals"]["test"]) == set(about["metrics"]["test"]) - {"num_demos"}
    assert about["metrics_constant"]["effective_rank"] == 0.0
    assert "straightness" in (embedding_folder / "README.md").read_text()


def test_curves_go_to_tensorboard_on_request(demos: Demos, tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    config = replace(QUICK_FIT, steps=20)
    fit(demos, tmp_path / "e", config=config, num_seeds=2, seed=4, tensorboard=True)
    events = accumulator.EventAccumulator(str(tmp_path / "e" / "tensorboard")).Reload()
    assert {"bound/seed 4", "bound/seed 5", "midpoint_error/seed 5"} <= set(events.Tags()["scalars"])
    assert events.Scalars("bound/seed 4")[-1].step == 20


def test_a_running_average_lags_behind(demos: Demos, tmp_path: Path) -> None:
    def weights(name: str, average: float) -> np.ndarray:
        config = replace(QUICK_FIT, steps=50, average=average)
        return fit(demos, tmp_path / name, config=config, num_seeds=1, seed=0).encoder[0][0]

    first, last, slow = (
        fit(
            demos,
            tmp_path / "first",
            config=replace(QUICK_FIT, steps=1, learning_rate=1e-9),
            num_seeds=1,
            seed=0,
        ).encoder[0][0],
        weights("last", 0.0),
        weights("slow", 0.99),
    )
    assert 0 < np.abs(slow - first).mean() < 0.7 * np.abs(last - first).mean()


def test_numbers_out_of_range_are_named() -> None:
    for changes, name in (
        ({"z_dim": 0}, "z_dim"),
        ({"spacings": (1, -3)}, "spacings"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"prior": -1.0}, "weights of the objective"),
    ):
        with pytest.raises(UsageError, match=f"{name}.* must be at least"):
            PRESETS["modern"].changed(**changes)


def test_z_of_any_size(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, steps=20, z_dim=10)
    embedding = fit(demos, tmp_path / "e", config=config, num_seeds=1, seed=0)
    assert embedding.encode(np.zeros(4)).shape == (10,)
