import json
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import optax
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.embed import fit as module
from planspace.embed import steps, training
from planspace.embed.config import PRESETS
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.embed.geometry import measure
from planspace.embed.inputs import Inputs
from planspace.embed.saved_embedding import load_embedding
from planspace.embed.training import CHUNK
from planspace.errors import PlanspaceError, UsageError
from planspace.storage.arrays import read_arrays, read_arrays_and_metadata
from planspace.storage.checkpoint import FILE
from planspace.storage.files import file_hash

from ..conftest import QUICK_FIT


@pytest.mark.slow
def test_training_makes_plans_straighter_than_the_state_and_the_untrained_map(
    demos: Demos, tmp_path: Path
) -> None:
    config = replace(PRESETS["modern"], steps=600, batch=128)
    trained = fit_embedding(demos, out=tmp_path / "a", config=config, num_seeds=2).require_about()
    untrained = fit_embedding(
        demos, out=tmp_path / "b", config=replace(config, steps=1), num_seeds=2, seed=0
    ).require_about()
    z, raw = trained.metrics["train"], trained.metrics_raw_state
    assert z["straightness"] > 1.3 * raw["straightness"]
    assert z["midpoint_error"] < untrained.metrics["train"]["midpoint_error"]
    assert z["decoded_error"] < 0.6 * untrained.metrics["train"]["decoded_error"]
    assert z["active_dims"] == 3


@pytest.mark.slow
def test_interrupted_training_gives_the_same_weights_bit_for_bit(
    demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(QUICK_FIT, steps=3 * CHUNK, batch=16)
    fit_embedding(demos, out=tmp_path / "uninterrupted", config=config, num_seeds=2, seed=3)
    run_steps, calls = steps.run_steps, []

    def interrupted(*args):
        if int(args[2]) > 1:  # not the single step that checks the stretch before it
            calls.append(1)
            if len(calls) == 2:
                raise KeyboardInterrupt
        return run_steps(*args)

    monkeypatch.setattr(steps, "run_steps", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fit_embedding(demos, out=tmp_path / "interrupted", config=config, num_seeds=2, seed=3)
    fit_embedding(demos, out=tmp_path / "interrupted", config=config, num_seeds=2, seed=3)
    assert len(calls) == 4  # one done, one interrupted, two after the restart: none is repeated
    name = "embedding.safetensors"
    assert file_hash(tmp_path / "interrupted" / name) == file_hash(tmp_path / "uninterrupted" / name)


@pytest.mark.nightly
def test_a_seed_does_not_depend_on_the_other_seeds(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, steps=50, batch=16)
    single = fit_embedding(demos, out=tmp_path / "single", config=config, num_seeds=1, seed=1, split_seed=0)
    both = fit_embedding(demos, out=tmp_path / "both", config=config, num_seeds=2)
    a = single.require_about().metrics_of_seeds[1]["straightness"]
    b = both.require_about().metrics_of_seeds[1]["straightness"]
    assert a == pytest.approx(b, rel=1e-3)  # only rounding differs between batch sizes


@pytest.mark.parametrize("num_seeds", [1, 2, 3, 4, 5, 7, 20, 50])
def test_seeds_are_trained_in_groups_of_two_or_three(num_seeds: int) -> None:
    groups = [range(num_seeds)[g] for g in steps.seed_groups(num_seeds)]
    assert [seed for group in groups for seed in group] == list(range(num_seeds))
    assert {len(group) for group in groups} <= ({2, 3} if num_seeds > 1 else {1})


@pytest.mark.nightly
def test_weights_do_not_depend_on_the_number_of_cores(
    demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(QUICK_FIT, steps=CHUNK, batch=16)
    for cores in (1, 2):
        monkeypatch.setattr(steps, "count_cores", lambda cores=cores: cores)
        fit_embedding(demos, out=tmp_path / str(cores), config=config)
    hashes = {file_hash(tmp_path / str(cores) / FILE) for cores in (1, 2)}
    assert len(hashes) == 1


def test_an_unknown_device_is_refused() -> None:
    with pytest.raises(UsageError, match="no device 'abacus'"):
        training.use_device("abacus")


@pytest.mark.slow
def test_the_paper_preset_has_raw_inputs(demos: Demos, tmp_path: Path) -> None:
    embedding = fit_embedding(
        demos, out=tmp_path / "e", config=replace(PRESETS["paper"], steps=100), num_seeds=1, seed=0
    )
    assert embedding.inputs.form == "raw"
    assert (embedding.inputs.mean == 0).all() and (embedding.inputs.std == 1).all()
    paper = PRESETS["paper"]
    assert (paper.objective.linearity, paper.objective.prior, paper.batch) == (0.5, 1.0, 50)


def test_paper_selects_by_path_error_and_modern_by_midpoint_error(demos: Demos) -> None:
    inputs = Inputs.fit(demos.states, demos.info.names, demos.info.units, (1,), "raw")
    read = np.eye(4)

    def one_number(column: int) -> Embedding:
        layer = np.stack([read[column], 0 * read[0]])
        back = np.concatenate([read[:, [column]], 0 * read[:, [0]]])
        return Embedding(inputs, ([layer], [np.zeros(2)]), ([back], [np.zeros(8)]), 0.0)

    candidates, split = [one_number(c) for c in (0, 2, 3)], demos.split(0)
    path = [measure(e, demos, split["train"]).path_error for e in candidates]
    midpoint = [measure(e, demos, split["validation"]).midpoint_error for e in candidates]
    assert np.argmin(path) != np.argmin(midpoint)  # otherwise the test would show nothing
    modern = replace(PRESETS["modern"], z_dim=1)
    assert module.choose(candidates, demos, split, PRESETS["paper"])[0] == np.argmin(path)
    assert module.choose(candidates, demos, split, modern)[0] == np.argmin(midpoint)


def test_modern_prefers_a_seed_without_collapsed_dimensions(embedding: Embedding, demos: Demos) -> None:
    embedding = replace(embedding, linear_map=None)
    weights, biases = embedding.encoder
    last = weights[-1].copy()
    last[0] = 0.0  # the first dimension's mean no longer depends on the state
    collapsed = replace(embedding, encoder=([*weights[:-1], last], biases))
    split = demos.split(0)
    chosen, validation = module.choose([collapsed, embedding], demos, split, PRESETS["modern"])
    assert chosen == 1
    assert [g.active_dims for g in validation] == [2, 3]


def test_no_seed_is_chosen_by_a_path_error_of_one_demonstration(embedding: Embedding, demos: Demos) -> None:
    """It is 0 but for rounding for every seed; the better seed is in the second place."""
    weights, biases = embedding.encoder
    rng = np.random.default_rng(0)
    random = replace(embedding, encoder=([rng.normal(size=w.shape) for w in weights], biases))
    split = demos.split(0) | {"train": np.array([0])}
    for candidates in ([random, embedding], [embedding, random]):
        chosen, _ = module.choose(candidates, demos, split, PRESETS["paper"])
        assert candidates[chosen] is embedding


def test_a_seed_whose_z_stands_still_is_not_chosen(embedding: Embedding, demos: Demos) -> None:
    weights, biases = embedding.encoder
    still = replace(embedding, encoder=([0 * weight for weight in weights], biases))
    for candidates in ([still, embedding], [embedding, still]):
        chosen, validation = module.choose(candidates, demos, demos.split(0), PRESETS["modern"])
        assert candidates[chosen] is embedding
        assert np.isnan(validation[1 - chosen].midpoint_error)


def test_a_finished_embedding_is_loaded_and_other_settings_are_refused(
    demos: Demos, embedding_folder: Path
) -> None:
    before = file_hash(embedding_folder / "embedding.json")
    fit_embedding(demos, out=embedding_folder, config=QUICK_FIT, num_seeds=2)
    assert file_hash(embedding_folder / "embedding.json") == before
    with pytest.raises(PlanspaceError, match=r"fit.z_dim was 3, now 10"):
        fit_embedding(demos, out=embedding_folder, config=replace(QUICK_FIT, z_dim=10), num_seeds=2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "broken",
    [pytest.param(99, marks=pytest.mark.nightly), 150, pytest.param(249, marks=pytest.mark.nightly)],
)
def test_the_checkpoint_of_a_diverged_training_is_from_before_the_divergence(
    demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: int
) -> None:
    """The update of step `broken` is infinite: the last of a stretch, one within it, or the last of all."""

    def make_optimiser(config):
        def rate(count):
            return jnp.where(count == broken, jnp.inf, 1e-3)

        return optax.adam(rate)

    monkeypatch.setattr(steps, "make_optimiser", make_optimiser)
    config = replace(QUICK_FIT, steps=250, batch=16, learning_rate=1e-3 + broken * 1e-9)
    message = rf"diverged at step {broken + 1} for seed 5; .* before, at step {broken}\."
    for _ in range(2):  # the second call continues from the checkpoint
        with pytest.raises(PlanspaceError, match=message):
            fit_embedding(demos, out=tmp_path / "e", config=config, num_seeds=2, seed=5)
        saved = tmp_path / "e" / "checkpoint" / "state.safetensors"
        assert read_arrays_and_metadata(saved)[1] == {"step": broken}
        assert all(np.isfinite(a).all() for a in read_arrays(saved).values())
    assert not (tmp_path / "e" / "embedding.json").exists()


def test_times_that_do_not_increase_are_refused(demos: Demos, tmp_path: Path) -> None:
    still = replace(demos, times=np.zeros_like(demos.times))
    with pytest.raises(PlanspaceError, match="times of a demonstration do not increase"):
        fit_embedding(still, out=tmp_path / "e", config=QUICK_FIT, num_seeds=1)


def test_refused_demonstrations_leave_no_folder(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, columns=("elbow",))
    with pytest.raises(PlanspaceError, match="'elbow' is missing"):
        fit_embedding(demos, out=tmp_path / "e", config=config, num_seeds=1)
    assert not (tmp_path / "e").exists()
    short = Demos.from_episodes(demos.info, [_shortened(demos, i, 12 if i else 9) for i in range(3)])
    bad = next(name for name, part in short.split(0).items() if 0 in part)
    with pytest.raises(PlanspaceError, match=f"states; the longest of 1 in the {bad} split has 9"):
        fit_embedding(short, out=tmp_path / "e", config=QUICK_FIT, num_seeds=1)
    assert not (tmp_path / "e").exists()


def _shortened(demos: Demos, i: int, length: int) -> Episode:
    e = demos.episode(i)
    return replace(e, states=e.states[:length], controls=e.controls[: length - 1], times=e.times[:length])


@pytest.mark.parametrize(
    "name",
    [
        "pca",
        *(
            pytest.param(name, marks=pytest.mark.slow if name == "direct" else pytest.mark.nightly)
            for name in ("direct", "vae", "e2c", "straightening", "distance", "random", "shuffled")
        ),
    ],
)
def test_every_objective_makes_an_embedding(demos: Demos, tmp_path: Path, name: str) -> None:
    config = replace(QUICK_FIT.with_objective(name), steps=30)
    embedding = fit_embedding(demos, out=tmp_path / "e", config=config, num_seeds=2)
    assert embedding.require_about().settings.fit["objective"]["name"] == name
    assert np.isfinite(embedding.encode(demos.states)).all()
    assert load_embedding(tmp_path / "e").hash == embedding.hash


@pytest.mark.nightly
def test_the_encoder_of_the_objective_random_is_not_trained(demos: Demos, tmp_path: Path) -> None:
    short, long = (
        fit_embedding(
            demos,
            out=tmp_path / str(n),
            config=replace(QUICK_FIT.with_objective("random"), steps=n),
            num_seeds=1,
        )
        for n in (1, 200)
    )
    for a, b in zip(short.encoder[0], long.encoder[0], strict=True):
        np.testing.assert_array_equal(a, b)
    error_1, error_200 = (e.require_about().metrics["train"]["decoded_error"] for e in (short, long))
    assert error_200 < error_1


@pytest.mark.slow
def test_only_the_chosen_columns_are_read(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, steps=30, columns=("hingevel", "hinge"))
    embedding = fit_embedding(demos, out=tmp_path / "e", config=config, num_seeds=1)
    assert embedding.inputs.names == ("hingevel", "hinge")
    assert embedding.inputs.circular_columns == (1,)
    assert embedding.require_about().metrics["test"]["num_demos"] == 1
    with pytest.raises(PlanspaceError, match="'elbow' is missing"):
        fit_embedding(
            demos, out=tmp_path / "f", config=replace(config, columns=("elbow",)), num_seeds=1, seed=0
        )


def test_log_split_metrics_and_card_are_saved(embedding_folder: Path, demos: Demos) -> None:
    rows = [json.loads(line) for line in (embedding_folder / "log.jsonl").read_text().splitlines()]
    assert rows[-1]["step"] == QUICK_FIT.steps
    assert len(rows[-1]["bound"]) == len(rows[-1]["path_error"]) == len(rows[-1]["midpoint_error"]) == 2
    about = load_embedding(embedding_folder).require_about()
    assert {name: len(part) for name, part in about.split.items()} == {
        "train": 10,
        "validation": 1,
        "test": 1,
    }
    assert about.metrics["validation"]["midpoint_error"] == pytest.approx(
        about.metrics_of_seeds[about.seed]["midpoint_error"]
    )
    assert about.intervals["test"] == {}  # the test split has one demonstration
    assert about.metrics_constant["effective_rank"] == 0.0
    assert "straightness" in (embedding_folder / "README.md").read_text()


@pytest.mark.nightly
def test_curves_are_written_for_tensorboard(demos: Demos, tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    config = replace(QUICK_FIT, steps=20)
    fit_embedding(demos, out=tmp_path / "e", config=config, num_seeds=2, seed=4, tensorboard=True)
    events = accumulator.EventAccumulator(str(tmp_path / "e" / "tensorboard")).Reload()
    assert {"bound/seed 4", "bound/seed 5", "midpoint_error/seed 5"} <= set(events.Tags()["scalars"])
    assert events.Scalars("bound/seed 4")[-1].step == 20


@pytest.mark.nightly
def test_averaged_weights_change_more_slowly(demos: Demos, tmp_path: Path) -> None:
    def weights(name: str, average: float) -> np.ndarray:
        config = replace(QUICK_FIT, steps=50, average=average)
        return fit_embedding(demos, out=tmp_path / name, config=config, num_seeds=1).encoder[0][0]

    first, last, slow = (
        fit_embedding(
            demos,
            out=tmp_path / "first",
            config=replace(QUICK_FIT, steps=1, learning_rate=1e-9),
            num_seeds=1,
        ).encoder[0][0],
        weights("last", 0.0),
        weights("slow", 0.99),
    )
    assert 0 < np.abs(slow - first).mean() < 0.7 * np.abs(last - first).mean()


def test_settings_out_of_range_are_refused_by_name() -> None:
    for changes, name in (
        ({"z_dim": 0}, "z_dim"),
        ({"spacings": (1, -3)}, "spacings"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"prior": -1.0}, "prior"),
        ({"linearity": float("nan")}, "linearity"),
        ({"sigma_floor": -0.1}, "sigma_floor"),
    ):
        with pytest.raises(UsageError, match=f"`{name}` must be .*, got "):
            PRESETS["modern"].with_settings(**changes)


@pytest.mark.nightly
def test_z_of_ten_dimensions(demos: Demos, tmp_path: Path) -> None:
    config = replace(QUICK_FIT, steps=20, z_dim=10)
    embedding = fit_embedding(demos, out=tmp_path / "e", config=config, num_seeds=1)
    assert embedding.encode(np.zeros(4)).shape == (10,)


def test_states_with_huge_numbers_are_refused(demos: Demos, tmp_path: Path) -> None:
    states = demos.states.copy()
    states[-1] = 1e300
    with pytest.raises(PlanspaceError, match="states contain a number that is not finite, or larger than 1e"):
        fit_embedding(
            replace(demos, states=states), out=tmp_path / "e", config=QUICK_FIT, num_seeds=1, seed=0
        )
    assert not (tmp_path / "e").exists()
