import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace import load_embedding
from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.embed.networks import GaussianNetwork, PlanSpaceModel
from planspace.errors import PlanspaceError, UsageError
from planspace.storage.json_files import read_sealed, write_sealed

NUMPY_TOLERANCE = 1e-5
INPUTS = Inputs(
    ("x", "theta", "xd", "thetad"),
    ("m", "rad", "m/s", "rad/s"),
    (1,),
    "trig",
    np.full(5, 0.1),
    np.full(5, 2.0),
)


def layers(network: GaussianNetwork) -> tuple[list[np.ndarray], list[np.ndarray]]:
    return [np.asarray(w) for w in network.weights], [np.asarray(b) for b in network.biases]


def test_numpy_and_jax_compute_the_same(rng: np.random.Generator) -> None:
    model = PlanSpaceModel(5, 3, (64, 64), 0.2, key=jr.key(0))
    embedding = Embedding(INPUTS, layers(model.encode), layers(model.decode), 0.2)
    states = rng.normal(0, 3, (50, 4))
    q = jax.vmap(model.encode)(jnp.asarray(INPUTS(states), dtype=jnp.float32))
    mu, sigma = embedding.encode_distribution(states)
    np.testing.assert_allclose(mu, q.mu, atol=NUMPY_TOLERANCE)
    np.testing.assert_allclose(sigma, q.sigma, atol=NUMPY_TOLERANCE)
    decoded = jax.vmap(lambda z: model.decode(z).mu)(q.mu)
    np.testing.assert_allclose(embedding.decode(mu), INPUTS.invert(np.asarray(decoded)), atol=1e-4)


def test_inputs_by_hand_and_their_inverse() -> None:
    state = np.array([0.5, 7.0, -1.0, 2.0])
    expected = (np.array([0.5, np.sin(7.0), np.cos(7.0), -1.0, 2.0]) - 0.1) / 2.0
    np.testing.assert_allclose(INPUTS(state), expected)
    np.testing.assert_allclose(INPUTS.invert(INPUTS(state)), [0.5, 7.0 - 2 * np.pi, -1.0, 2.0])


def test_states_in_another_unit_are_refused(embedding: Embedding) -> None:
    degrees = replace(embedding, inputs=replace(INPUTS, units=("m", "deg", "m/s", "")))
    assert degrees.columns_of(INPUTS.names) == degrees.columns_of(INPUTS.names, ("", "deg", "m/s", "rad/s"))
    with pytest.raises(UsageError, match="reads 'theta' in deg, but here it is in rad; train it on"):
        degrees.columns_of(("thetad", *INPUTS.names[:3]), ("rad/s", "m", "rad", "m/s"))


def test_a_full_turn_does_not_change_z(embedding: Embedding) -> None:
    state = np.array([0.1, 1.0, 0.2, 0.3])
    wound = state + np.array([0, 2 * np.pi, 0, 0])
    np.testing.assert_allclose(embedding.encode(wound), embedding.encode(state), atol=1e-5)
    assert embedding.distance(state, wound) == pytest.approx(0.0, abs=1e-5)


def test_states_may_have_any_leading_axes(embedding: Embedding, rng: np.random.Generator) -> None:
    states = rng.normal(size=(2, 3, 4))
    z = embedding.encode(states)
    assert z.shape == (2, 3, embedding.z_dim)
    np.testing.assert_allclose(z[1, 2], embedding.encode(states[1, 2]), atol=1e-5)


def test_a_loaded_embedding_is_the_same_and_is_not_overwritten(
    embedding: Embedding, tmp_path: Path, rng: np.random.Generator
) -> None:
    embedding.save(tmp_path / "e")
    with pytest.raises(PlanspaceError, match="already holds an embedding"):
        embedding.save(tmp_path / "e")
    back, states = load_embedding(tmp_path / "e"), rng.normal(size=(9, 4))
    np.testing.assert_array_equal(back.encode(states), embedding.encode(states))
    assert back.about == embedding.about
    assert back.hash == embedding.hash


@pytest.mark.parametrize("file", ["embedding.json", "embedding.safetensors"])
def test_errors_name_the_altered_file(embedding: Embedding, file: str, tmp_path: Path) -> None:
    embedding.save(tmp_path / "e")
    path = tmp_path / "e" / file
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(PlanspaceError, match=file):
        load_embedding(tmp_path / "e")


def test_states_of_another_size_and_other_folders_are_refused(embedding: Embedding, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"states of 4 numbers \(slider, hinge, .*\), got 6"):
        embedding.encode(np.zeros((2, 6)))
    with pytest.raises(PlanspaceError, match="is not an embedding"):
        load_embedding(tmp_path)


def test_errors_name_a_constant_state() -> None:
    states = np.random.default_rng(0).normal(size=(20, 2))
    states[:, 1] = 3.0
    with pytest.raises(PlanspaceError, match="the state 'b' is constant"):
        Inputs.fit(states, ("a", "b"), ("", ""), (), "trig")


def test_loading_needs_neither_jax_nor_mujoco(embedding_folder: Path) -> None:
    code = (
        "import sys; sys.modules.update(dict.fromkeys(('jax', 'mujoco', 'matplotlib', 'scipy')))\n"
        "import numpy as np, planspace\n"
        f"e = planspace.load_embedding({str(embedding_folder)!r}); print(e.encode(np.zeros(4)).shape)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(3,)"


def test_a_newer_schema_and_another_kind_are_refused(embedding: Embedding, tmp_path: Path) -> None:
    embedding.save(tmp_path / "e")
    path = tmp_path / "e" / "embedding.json"
    text = read_sealed(path)
    for change, message in (
        ({"schema": 99, "architecture": "of tomorrow"}, r"newer planspace \(schema 99; .*upgrade planspace"),
        ({"kind": "demos"}, "is of kind 'demos', expected 'embedding'"),
        ({"architecture": "transformer"}, "names the architecture 'transformer'"),
    ):
        write_sealed(path, {**text, **change})
        with pytest.raises(PlanspaceError, match=message):
            load_embedding(tmp_path / "e")


def test_columns_are_found_by_name(embedding: Embedding) -> None:
    names = ("time", "hinge", "slidervel", "hingevel", "slider")
    assert embedding.columns_of(names) == (4, 1, 2, 3)
    with pytest.raises(
        PlanspaceError, match=r"reads states of 4 numbers \(slider, .*\), these have 2 \(slider, hinge\): 'sl"
    ):
        embedding.columns_of(("slider", "hinge"))


def test_z_of_another_size_is_refused(embedding: Embedding) -> None:
    with pytest.raises(PlanspaceError, match=r"z has 3 numbers, got an array of shape \(2,\)"):
        embedding.decode(np.zeros(2))


@pytest.mark.parametrize("shape", [(), (1,), (63,), (64,), (65,), (3, 70), (0,)])
def test_encoding_in_blocks_gives_the_same_z(
    embedding: Embedding, shape: tuple[int, ...], rng: np.random.Generator
) -> None:
    states = rng.normal(size=(*shape, 4))
    z = embedding.encode(states)
    assert z.shape == (*shape, 3) and z.dtype == np.float32
    for i in np.ndindex(shape):
        np.testing.assert_allclose(z[i], embedding.encode_distribution(states[i])[0], atol=1e-5)
