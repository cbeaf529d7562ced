"""A rotation has one z, whatever the sign, the length and the order of its quaternion."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import planspace as ps
from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.embed.card import model_card
from planspace.embed.config import PRESETS
from planspace.embed.export import export_onnx
from planspace.embed.inputs import Inputs
from planspace.embed.measurement import measure_embedding
from planspace.errors import PlanspaceError, UsageError
from planspace.physics import quaternion
from planspace.storage.json_files import read_sealed, write_sealed

from .random_encoder import ROTATING, random_states

TOLERANCE = 1e-5
NAMES = ("x", "qw", "qx", "qy", "qz", "v")
INFO = StateInfo(NAMES, ("m", "", "", "", "", "m/s"), (), 0, quaternion_columns=(1,))
SIGN = np.array([1.0, -1.0, -1.0, -1.0, -1.0, 1.0])
FAST = PRESETS["modern"].with_settings(steps=20, batch=16)


def columns_of(q: np.ndarray) -> np.ndarray:
    return np.stack(quaternion.rotation_columns(*np.moveaxis(q, -1, 0)), axis=-1)


def turning_demos(yaw_only: bool = False) -> Demos:
    """Ten bodies that turn and move, with the signs of all quaternions of every second one reversed."""
    rng, episodes = np.random.default_rng(0), []
    for i in range(10):
        t = np.linspace(0, 1, 25)[:, None]
        axis = np.array([[0.0, 0.0, 1.0]]) if yaw_only else rng.normal(size=(1, 3))
        q = quaternion.multiply(
            quaternion.exp(axis * t), quaternion.exp(axis if yaw_only else rng.normal(size=3))
        )
        states = np.concatenate([rng.normal() + t, q * (-1) ** i, np.cos(3 * t) + rng.normal()], axis=1)
        episodes.append(Episode(states, np.zeros((24, 0)), t[:, 0], states[-1], True, i, 0))
    return Demos.from_episodes(INFO, episodes)


def test_columns_of_the_rotation_matrix_are_those_of_scipy() -> None:
    q = np.random.default_rng(0).normal(size=(50, 4))
    matrix = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()
    expected = np.concatenate([matrix[:, :, 0], matrix[:, :, 1]], axis=1)
    np.testing.assert_allclose(columns_of(q), expected, atol=1e-14)
    np.testing.assert_array_equal(columns_of(-q), columns_of(q))
    np.testing.assert_allclose(columns_of(3 * q), columns_of(q), atol=1e-14)
    np.testing.assert_array_equal(columns_of(np.zeros(4)), [1, 0, 0, 0, 1, 0])  # the identity, as in MuJoCo


def test_a_quaternion_by_hand() -> None:
    """A quarter turn about z takes x to y, and y to -x."""
    half = np.sqrt(0.5)
    np.testing.assert_allclose(columns_of(np.array([half, 0, 0, half])), [0, 1, 0, -1, 0, 0], atol=1e-15)


def test_the_quaternion_of_a_rotation_matrix() -> None:
    q = quaternion.sample(np.random.default_rng(0), 1000)
    half_turns = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, 0.8, 0]])
    for batch in (q, half_turns, q.reshape(10, 100, 4)):
        found = quaternion.from_rotation_columns(columns_of(batch))
        assert (found[..., 0] >= 0).all()
        np.testing.assert_allclose(np.abs((found * batch).sum(-1)), 1.0, atol=1e-12)
    skewed = columns_of(q) * np.repeat([[2.0, 0.5]], 3, axis=1).ravel()  # columns of other lengths
    found = quaternion.from_rotation_columns(skewed)
    np.testing.assert_allclose(np.abs((found * q).sum(-1)), 1.0, atol=1e-12)
    for degenerate in (np.zeros(6), np.array([0, 0, 1.0, 0, 0, 2.0])):
        np.testing.assert_allclose(np.linalg.norm(quaternion.from_rotation_columns(degenerate)), 1.0)


def test_states_are_converted_to_inputs_and_back() -> None:
    inputs, states = ROTATING.inputs, random_states(ROTATING, 40).astype(float)
    back = inputs.invert(inputs(states))
    plain = [1, 6, 7, 8]
    np.testing.assert_allclose(back[:, plain], states[:, plain], atol=1e-9)
    for column in inputs.circular_columns:
        np.testing.assert_allclose(np.exp(1j * back[:, column]), np.exp(1j * states[:, column]), atol=1e-9)
    for columns in inputs.quaternions:
        q = states[:, columns] / np.linalg.norm(states[:, columns], axis=1, keepdims=True)
        np.testing.assert_allclose(np.abs((back[:, columns] * q).sum(1)), 1.0, atol=1e-9)
        assert (back[:, columns[0]] >= 0).all()


def changed_signs(states: np.ndarray) -> list[np.ndarray]:
    """The states with another sign of the first, the second and both quaternions."""
    found = []
    for which in ((0,), (1,), (0, 1)):
        flipped = states.copy()
        for k in which:
            flipped[:, ROTATING.inputs.quaternions[k]] *= -1
        found.append(flipped)
    return found


def test_z_does_not_depend_on_the_sign() -> None:
    states = random_states(ROTATING, 30)
    for flipped in changed_signs(states):
        np.testing.assert_array_equal(ROTATING.encode(flipped), ROTATING.encode(states))


def test_exported_encoders_do_not_depend_on_the_sign(tmp_path: Path) -> None:
    states = random_states(ROTATING, 30)
    encoders = {"jax": jax.jit(ps.jax_function(ROTATING))}
    try:
        import torch

        module = ps.torch_module(ROTATING)
        encoders["torch"] = lambda x: module(torch.tensor(x)).numpy()
        assert set(module.state_dict()) == set(ps.torch_module(ROTATING).double().state_dict())
    except ImportError:
        pass
    try:
        import onnxruntime

        export_onnx(ROTATING, tmp_path / "e.onnx")
        session = onnxruntime.InferenceSession(tmp_path / "e.onnx", providers=["CPUExecutionProvider"])
        encoders["onnx"] = lambda x: session.run(["mu"], {"state": x})[0]
    except ImportError:
        pass
    for name, encode in encoders.items():
        z = np.asarray(encode(states))
        np.testing.assert_allclose(z, ROTATING.encode(states), rtol=TOLERANCE, atol=TOLERANCE, err_msg=name)
        for flipped in changed_signs(states):
            np.testing.assert_array_equal(np.asarray(encode(flipped)), z, err_msg=name)


REORDERED = ("qx", "qy", "qz", "qw", "v")


@pytest.mark.parametrize("columns", [(), pytest.param(REORDERED, marks=pytest.mark.nightly)])
def test_training_finds_the_quaternions_in_any_order(columns: tuple[str, ...], tmp_path: Path) -> None:
    demos = turning_demos()
    config = replace(FAST, columns=columns)
    e = ps.fit_embedding(demos, config=config, num_seeds=1, out=tmp_path / "e", verbose=False)
    assert e.inputs.quaternions == (((3, 0, 1, 2),) if columns else ((1, 2, 3, 4),))
    read = list(e.columns_of(NAMES))
    z = e.encode(demos.states[:, read])
    np.testing.assert_array_equal(e.encode((demos.states * SIGN)[:, read]), z)
    loaded = ps.load_embedding(tmp_path / "e")
    assert loaded.inputs.quaternions == e.inputs.quaternions and loaded.hash == e.hash
    np.testing.assert_array_equal(loaded.encode(demos.states[:, read]), z)
    assert read_sealed(tmp_path / "e" / "embedding.json")["schema"] == 3
    checks = measure_embedding(loaded, demos).checks
    assert checks.change_by_a_sign == 0.0 and checks.change_by_a_turn is None


def test_signs_in_the_demonstrations_do_not_change_the_training() -> None:
    demos = turning_demos()
    flipped = replace(demos, states=demos.states * SIGN, goals=demos.goals * SIGN)
    first, second = (ps.fit_embedding(d, config=FAST, num_seeds=1, verbose=False) for d in (demos, flipped))
    np.testing.assert_array_equal(first.encode(demos.states), second.encode(demos.states))
    metrics = [measure_embedding(e, d).splits["test"] for e, d in ((first, demos), (second, flipped))]
    assert metrics[0].embedding.decoded_error == pytest.approx(metrics[1].embedding.decoded_error, rel=1e-9)


def test_a_rotation_about_one_axis_can_be_trained() -> None:
    """qx and qy are 0, and so are three of the six numbers; the rotation is not constant."""
    demos = turning_demos(yaw_only=True)
    e = ps.fit_embedding(demos, config=FAST, num_seeds=1, verbose=False)
    assert e.inputs.quaternions and np.isfinite(e.encode(demos.states)).all()
    still = demos.states.copy()
    still[:, 1:5] = [1.0, 0, 0, 0]
    with pytest.raises(PlanspaceError, match="'qw' is constant"):
        ps.fit_embedding(replace(demos, states=still), config=FAST, verbose=False)


def test_a_part_of_a_quaternion_is_refused() -> None:
    demos, config = turning_demos(), replace(FAST, columns=("x", "qw", "qz"))
    with pytest.raises(UsageError, match=r"2 of the four numbers .* qw, qz\. Its sign is arbitrary"):
        ps.fit_embedding(demos, config=config, verbose=False)


def test_raw_quaternions_are_reported_by_measure() -> None:
    demos = turning_demos()
    config = PRESETS["paper"].with_settings(steps=20, batch=16)
    e = ps.fit_embedding(demos, config=config, num_seeds=1, verbose=False)
    found = measure_embedding(e, demos)
    assert found.checks.change_by_a_sign is not None and found.checks.change_by_a_sign > 0.1
    # an embedding of an earlier version does not know the quaternion, but the dataset does
    earlier = replace(e, inputs=replace(e.inputs, quaternions=()))
    assert measure_embedding(earlier, demos).checks.change_by_a_sign == found.checks.change_by_a_sign


@pytest.mark.parametrize("wrong", [[[0, 1, 2]], [[0, 1, 2, 9]], [[1, 1, 2, 3]], [5], "text"])
def test_wrong_quaternions_in_a_file_are_refused(wrong, tmp_path: Path) -> None:
    e = ps.fit_embedding(turning_demos(), config=FAST, num_seeds=1, verbose=False)
    replace(e, about=None).save(tmp_path / "e")
    text = read_sealed(tmp_path / "e" / "embedding.json")
    text["inputs"]["quaternions"] = wrong
    write_sealed(tmp_path / "e" / "embedding.json", text)
    with pytest.raises(PlanspaceError, match=r"embedding\.json"):
        ps.load_embedding(tmp_path / "e")


def test_inputs_without_quaternions_are_as_before() -> None:
    states = np.random.default_rng(0).normal(size=(9, 3))
    inputs = Inputs.fit(states, ("a", "b", "c"), ("",) * 3, (1,), "trig")
    expected = np.stack([states[:, 0], np.sin(states[:, 1]), np.cos(states[:, 1]), states[:, 2]], axis=1)
    np.testing.assert_array_equal(inputs.expand(states), expected)
    np.testing.assert_allclose(inputs(states), (expected - expected.mean(0)) / expected.std(0), rtol=1e-14)
    assert inputs.on_manifold == [False, True, True, False]


def test_the_card_says_what_becomes_of_a_quaternion() -> None:
    decoder = ([np.zeros((2 * len(ROTATING.inputs.mean), 3))], [np.zeros(2 * len(ROTATING.inputs.mean))])
    text = model_card(replace(ROTATING, decoder=decoder))
    assert "`qw`, `qx`, `qy`, `qz` are a quaternion (w, x, y, z), which is replaced by" in text
