"""Encoders of pictures: the network in NumPy, checks of images, and a training with few steps."""

import json
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace import (
    Demos,
    ImageEncoder,
    ImageFitConfig,
    PictureConfig,
    fit_image_encoder,
    load_image_encoder,
)
from planspace.cli import main
from planspace.embed.config import FitConfig, find_objective
from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.embed.objectives.vae import AutoEncoder
from planspace.embed.pixels import training
from planspace.embed.pixels.config import PictureSpaceConfig
from planspace.embed.pixels.plan_space import DrawnPictures, PictureTriplets, Shrinking, learn_plan_space
from planspace.embed.pixels.stacks import draw_stacks, stacks_of_plans
from planspace.embed.pixels.training import init
from planspace.embed.pixels.twin import fit_twin
from planspace.embed.samples import make_samples
from planspace.errors import PlanspaceError, UsageError
from planspace.physics.pictures import Pictures
from planspace.storage.files import write_bytes

TINY = ImageFitConfig(
    stacks=48,
    channels=(4, 4),
    hidden=8,
    steps=30,
    batch=16,
    pictures=PictureConfig(width=16, height=16, frames=2),
)


@pytest.fixture(scope="module")
def folder(
    opengl: str, demos: Demos, embedding_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    from planspace import load_embedding

    out = tmp_path_factory.mktemp("pixels") / "encoder"
    fit_image_encoder(demos, load_embedding(embedding_folder), config=TINY, out=out, verbose=False)
    return out


@pytest.fixture
def encoder(folder: Path) -> ImageEncoder:
    return load_image_encoder(folder)


def test_numpy_computes_what_was_trained() -> None:
    network = init(TINY, 3, jr.key(0)).network
    images = np.random.default_rng(0).integers(0, 256, (5, *TINY.pictures.stack_shape), dtype=np.uint8)
    found = np.stack([network.to_numpy()(stack) for stack in images])
    np.testing.assert_allclose(found, network(jnp.asarray(images)), atol=1e-4)


def test_an_interrupted_training_ends_with_the_same_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (48, *TINY.pictures.stack_shape), dtype=np.uint8)
    given = (images, rng.normal(size=(48, 3)).astype(np.float32), TINY, 0)
    monkeypatch.setattr(training, "CHUNK", 10)
    (tmp_path / "whole").mkdir(), (tmp_path / "cut").mkdir()
    whole = training.train_network(*given, tmp_path / "whole")
    save = training.save_checkpoint

    def save_and_stop(folder: Path, tree: object, counters: dict[str, int]) -> None:
        save(folder, tree, counters)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(training, "save_checkpoint", save_and_stop)
        training.train_network(*given, tmp_path / "cut")
    continued = training.train_network(*given, tmp_path / "cut")
    np.testing.assert_array_equal(continued(images[0]), whole(images[0]))
    assert (tmp_path / "cut" / "log.jsonl").read_text().count("\n") == 3


def test_a_finished_training_is_loaded(folder: Path, encoder: ImageEncoder, demos: Demos) -> None:
    images = np.zeros((2, 3, *TINY.pictures.stack_shape), dtype=np.uint8)
    assert encoder.encode(images).shape == (2, 3, encoder.z_dim)
    assert encoder.states(images).shape == (2, 3, 4)
    again = fit_image_encoder(demos, encoder.teacher, config=TINY, out=folder)
    np.testing.assert_array_equal(again.encode(images), encoder.encode(images))
    losses = [json.loads(line)["loss"] for line in (folder / "log.jsonl").read_text().splitlines()]
    assert len(losses) == 1 and losses[0] > 0
    assert "Privileged state" in (folder / "README.md").read_text()
    with pytest.raises(PlanspaceError, match="was made with other settings: fit.steps"):
        fit_image_encoder(demos, encoder.teacher, config=replace(TINY, steps=31), out=folder)


@pytest.fixture(scope="module")
def learned_folder(opengl: str, demos: Demos, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An encoder that was trained on pictures alone."""
    out = tmp_path_factory.mktemp("pixels") / "learned"
    config = replace(TINY, target="pictures", space=PictureSpaceConfig(z_dim=2))
    fit_image_encoder(demos, config=config, out=out, verbose=False)
    return out


def test_a_plan_space_of_pictures_has_a_twin_for_states(learned_folder: Path, demos: Demos) -> None:
    encoder = load_image_encoder(learned_folder)
    plans, stacks = stacks_of_plans(demos, np.arange(len(demos)), TINY.pictures, encoder.frame_s)
    z, states = encoder.read(stacks.images)
    assert z.shape == (len(plans.states), 2) and states.shape == plans.states.shape
    of_states = encoder.teacher.encode(plans.states)
    assert np.sqrt((of_states.std(axis=0) ** 2).mean()) == pytest.approx(2.5, rel=0.3)
    assert "No state was\nused" in (learned_folder / "README.md").read_text()
    rows = [json.loads(line) for line in (learned_folder / "log.jsonl").read_text().splitlines()]
    assert {"loss", "log_likelihood", "midpoint_kl"} <= set(rows[-1])
    objective = json.loads((learned_folder / "config.json").read_text())["fit"]["space"]["objective"]
    assert objective["name"] == "variational" and objective["linearity"] == 200


def test_a_twin_computes_z_of_pictures_from_states(demos: Demos) -> None:
    info, x = demos.info, demos.states
    inputs = Inputs.fit(x, info.names, info.units, info.circular_columns, "trig")
    mu = inputs(x)[:, :2] @ np.array([[1.0, 2.0], [-1.0, 1.0]])
    twin = fit_twin(inputs, x, mu, np.full_like(mu, 0.2), 600, 0)
    found, sigma = twin.encode_distribution(x)
    np.testing.assert_allclose(sigma.mean(), 0.2, rtol=0.3)
    assert np.sqrt(((found - mu) ** 2).mean()) < 0.2
    assert np.sqrt(((inputs(twin.decode(mu)) - inputs(x))[:, :2] ** 2).mean()) < 0.5


def data_of(demos: Demos, config: ImageFitConfig) -> PictureTriplets:
    """Random pictures in place of those of the demonstrations, with their triplets."""
    shape = (len(demos.states), *config.pictures.stack_shape)
    images = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    info, every = demos.info, np.arange(len(demos))
    inputs = Inputs.fit(demos.states, info.names, info.units, info.circular_columns, "trig")
    samples = make_samples(demos, every, inputs, FitConfig(objective=config.space.objective), 0)
    return PictureTriplets(images, samples, images)


@pytest.mark.nightly
def test_states_of_plans_do_not_reach_a_plan_space_of_pictures(demos: Demos, tmp_path: Path) -> None:
    """Training data with other states, but the same pictures, give the same network."""
    config, found = replace(TINY, target="pictures", steps=3), []
    for name, states in (("same", demos.states), ("reversed", demos.states[::-1])):
        data = data_of(replace(demos, states=states), config)
        (tmp_path / name).mkdir()
        found.append(learn_plan_space(data, config, 0, tmp_path / name).read(data.images)[0])
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("name", ["vae", "straightening", "distance", "e2c", "shuffled"])
def test_other_objectives_work_on_pictures(demos: Demos, name: str, tmp_path: Path) -> None:
    space = PictureSpaceConfig(find_objective(name, TINY.space.objective), z_dim=2, warm_up=0.0)
    config = replace(TINY, target="pictures", space=space, steps=1, batch=8)
    learn_plan_space(data_of(demos, config), config, 0, tmp_path)
    assert np.isfinite(json.loads((tmp_path / "log.jsonl").read_text())["loss"])


def test_objectives_that_calculate_with_states_do_not(opengl: str, demos: Demos, tmp_path: Path) -> None:
    for name, message in (
        ("direct", "the loss of the Objective direct failed on its first sample"),
        ("pca", "the objective pca is computed from states"),
    ):
        space = PictureSpaceConfig(find_objective(name, TINY.space.objective))
        with pytest.raises(UsageError, match=message):
            config = replace(TINY, target="pictures", space=space)
            fit_image_encoder(demos, config=config, out=tmp_path / name, verbose=False)
        assert not (tmp_path / name).exists()


def test_the_weights_of_pictures_follow_the_likelihood() -> None:
    """The likelihood of a drawn stack is highest for the stack itself, and grows with the weight."""
    stacks = np.random.default_rng(0).integers(0, 256, (20, *TINY.pictures.stack_shape), dtype=np.uint8)
    shrink = Shrinking.fit(stacks)
    drawn = np.stack([shrink(jnp.asarray(stack)) for stack in stacks])
    half = drawn.shape[1] // 2
    np.testing.assert_allclose([drawn[:, :half].std(), drawn[:, half:].std()], 1.0, atol=1e-3)
    one, ten = (DrawnPictures(jnp.asarray(drawn[0]), jnp.asarray(0.5), shrink, w) for w in (1.0, 10.0))
    assert one.log_prob(jnp.asarray(stacks[0])) == pytest.approx(np.log(2), abs=1e-4)
    others = [float(one.log_prob(jnp.asarray(stack))) for stack in stacks[1:]]
    expected = [np.log(2) - 2 * ((x - drawn[0]) ** 2).mean() for x in drawn[1:]]
    np.testing.assert_allclose(others, expected, rtol=1e-4)
    assert ten.log_prob(jnp.asarray(stacks[1])) == pytest.approx(10 * others[0], rel=1e-4)


def test_a_target_and_what_belongs_to_another_are_refused(demos: Demos, embedding: Embedding) -> None:
    pictures, vae = replace(TINY, target="pictures"), PictureSpaceConfig(AutoEncoder())
    with pytest.raises(UsageError, match="learns a z of its own: leave out the teacher"):
        fit_image_encoder(demos, embedding, config=pictures)
    with pytest.raises(UsageError, match="the target 'z' needs a teacher"):
        fit_image_encoder(demos, config=TINY)
    with pytest.raises(UsageError, match="settings of the target 'pictures': with the target 'z'"):
        replace(TINY, space=vae)
    for name, wrong in (("z_dim", 0), ("picture_weight", 0.0), ("warm_up", 2.0)):
        with pytest.raises(UsageError, match=f"`{name}` must be"):
            replace(vae, **{name: wrong})


def test_the_error_of_its_states_is_kept(encoder: ImageEncoder, demos: Demos, tmp_path: Path) -> None:
    _, stacks = stacks_of_plans(demos, np.arange(len(demos)), TINY.pictures, encoder.frame_s)
    error = np.sqrt(((encoder.states(stacks.images) - stacks.states) ** 2).mean(axis=0))
    assert encoder.state_error is not None
    assert (np.abs(np.log(encoder.state_error / error)) < np.log(3)).all()
    old = replace(encoder, state_error=None)
    old.save(tmp_path / "old")
    assert load_image_encoder(tmp_path / "old").state_error is None
    replace(encoder, state_error=np.ones(3)).save(tmp_path / "wrong")
    with pytest.raises(PlanspaceError, match="the errors of its states are wrong"):
        load_image_encoder(tmp_path / "wrong")


def test_stacks_end_in_their_states(opengl: str, demos: Demos) -> None:
    """Stacks of motions and of plans show the same as `render_states`; a plan's first picture repeats."""
    plans, stacks = stacks_of_plans(demos, np.array([1]), TINY.pictures, 0.04)
    shown = plans.render_states(None, TINY.pictures)
    np.testing.assert_array_equal(stacks.images[..., -3:], shown)
    np.testing.assert_array_equal(stacks.images[1:, ..., :3], shown[:-1])
    np.testing.assert_array_equal(stacks.images[0, ..., :3], shown[0])
    drawn = draw_stacks([(demos, demos.states)], TINY, 0.04, 0)
    again = draw_stacks([(demos, demos.states)], TINY, 0.04, 0)
    np.testing.assert_array_equal(drawn.images, again.images)
    last = Pictures(*demos.info.compile(), TINY.pictures).of_states(drawn.states)
    np.testing.assert_array_equal(drawn.images[..., -3:], last)


def test_what_cannot_be_drawn_is_refused_before_anything_is_written(
    opengl: str, demos: Demos, embedding: Embedding, tmp_path: Path
) -> None:
    out = tmp_path / "encoder"
    for frame_s in (0.03, 0.001, 1e5):
        with pytest.raises(UsageError, match="`frame_s` must be a multiple of .* 0.02 s"):
            fit_image_encoder(demos, embedding, config=replace(TINY, frame_s=frame_s), out=out)
    with pytest.raises(UsageError, match="camera"):
        strange = replace(TINY, pictures=replace(TINY.pictures, camera="nope"))
        fit_image_encoder(demos, embedding, config=strange, out=out)
    assert not out.exists()


def test_other_colours_are_far_away(encoder: ImageEncoder, demos: Demos) -> None:
    own, strange = TINY.pictures, replace(TINY.pictures, vary_colors=0.5, vary_camera=0.3)
    rows = np.arange(0, len(demos.states), 20)
    stacks = [np.tile(demos.render_states(rows, config), 2) for config in (own, strange)]
    near, far = (np.median(encoder.distance(images)) for images in stacks)
    assert near < 1.2 and far > 2 * near


@pytest.mark.parametrize(
    ("shape", "dtype", "message"),
    [
        ((16, 16, 6), np.float32, "images must be uint8 from 0 to 255, got float32"),
        ((1, 6, 16, 16), np.uint8, r"channels last, \(16, 16, 6\), got \(6, 16, 16\): use np.moveaxis"),
        ((1, 32, 32, 6), np.uint8, r"2 frames of 16 x 16 pixels, \(16, 16, 6\), got \(32, 32, 6\)"),
        ((16, 16), np.uint8, r"2 frames of 16 x 16 pixels, \(16, 16, 6\), got \(16, 16\)"),
    ],
)
def test_wrong_images_are_refused(
    encoder: ImageEncoder, shape: tuple[int, ...], dtype: type, message: str
) -> None:
    for method in (encoder.encode, encoder.states, encoder.distance):
        with pytest.raises(UsageError, match=message):
            method(np.zeros(shape, dtype=dtype))


def test_damaged_and_missing_folders_are_refused(encoder: ImageEncoder, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="contains no encoder.json. `planspace pixels` makes one"):
        load_image_encoder(tmp_path)
    out = tmp_path / "copy"
    encoder.save(out)
    assert load_image_encoder(out).about == encoder.about
    write_bytes(out / "encoder.safetensors", b"damaged")
    with pytest.raises(PlanspaceError, match="its SHA-256 is not the one recorded"):
        load_image_encoder(out)
    assert main(["repair", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {
        "damaged-1-encoder.json",
        "damaged-1-encoder.safetensors",
        "teacher",
    }


def test_pictures_that_cannot_be_halved_are_refused() -> None:
    with pytest.raises(
        UsageError, match="`width` must be a multiple of 16, which 4 convolutions need, got 40"
    ):
        ImageFitConfig(pictures=PictureConfig(width=40))


def test_the_command_continues_a_finished_training(
    folder: Path, demo_folder: Path, embedding_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = "--stacks 48 --channels 4 4 --hidden 8 --steps 30 --batch 16 --width 16 --height 16 --frames 2"
    given = ["pixels", str(demo_folder), "--teacher", str(embedding_folder), "--out", str(folder)]
    assert main([*given, *options.split()]) == 0
    assert "on held-out plans" in capsys.readouterr().out
    assert main(["pixels", str(demo_folder)]) == 2
    assert "`--teacher EMBEDDING` is required" in capsys.readouterr().err
    assert main([*given, "--objective", "vae"]) == 2
    assert "settings of the target 'pictures'" in capsys.readouterr().err
    assert main([*given, "--linearity", "3"]) == 2
    assert "settings of the target 'pictures'" in " ".join(capsys.readouterr().err.split())


def test_other_run_folders_are_no_encoders(tmp_path: Path, folder: Path, embedding_folder: Path) -> None:
    from planspace import load_embedding

    for load, run in ((load_image_encoder, embedding_folder), (load_embedding, folder)):
        with pytest.raises(PlanspaceError, match="is not an e"):
            load(run)
    (tmp_path / "config.json").write_text('{"algorithm": {}}')
    for load in (load_image_encoder, load_embedding):
        with pytest.raises(PlanspaceError, match="is not an e"):
            load(tmp_path)
