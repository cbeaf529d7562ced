import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import planspace
from planspace.embed import export
from planspace.embed.embedding import Embedding, LinearMap
from planspace.embed.inputs import Inputs, InputType
from planspace.errors import PlanspaceError

from .random_encoder import random_encoder

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

TOLERANCE = 1e-5
SEVERAL_TURNS = 50.0


def run(path: Path, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    mu, sigma = session.run(["mu", "sigma"], {"state": states})
    return mu, sigma


def assert_same(embedding: Embedding, path: Path, states: np.ndarray) -> None:
    for ours, theirs in zip(embedding.encode_distribution(states), run(path, states), strict=True):
        assert theirs.dtype == np.float32 and theirs.shape == ours.shape
        assert (np.abs(ours - theirs) <= TOLERANCE * np.maximum(1.0, np.abs(ours))).all()


@pytest.mark.parametrize("hidden", [(64, 64), (16,), ()])
@pytest.mark.parametrize(
    ("form", "circular"),
    [("raw", (1,)), ("raw", ()), ("trig", ()), ("trig", (1,)), ("trig", (3, 1)), ("trig", (0, 1, 2, 3))],
)
def test_onnxruntime_gives_the_same_outputs(
    form: InputType, circular: tuple[int, ...], hidden: tuple[int, ...], tmp_path: Path, rng
) -> None:
    embedding = random_encoder(form, circular, hidden)
    export.export_onnx(embedding, tmp_path / "e.onnx")
    states = rng.normal(size=(200, 4))
    states[:, list(circular)] = rng.uniform(-1, 1, (200, len(circular))) * SEVERAL_TURNS
    if form == "trig" and 0 not in circular:
        states[:, 0] += embedding.inputs.mean[0]
    states = states.astype(np.float32)
    assert_same(embedding, tmp_path / "e.onnx", states)
    assert_same(embedding, tmp_path / "e.onnx", states[:1])  # any batch size


def test_a_trained_embedding_and_principal_components(embedding: Embedding, demos, tmp_path: Path) -> None:
    principal = pytest.importorskip("planspace.embed.principal").principal_components
    states = demos.states.astype(np.float32)
    for name, e in (("fit", embedding), ("pca", principal(embedding.inputs, demos.states, 2))):
        export.export_onnx(e, tmp_path / f"{name}.onnx")
        assert_same(e, tmp_path / f"{name}.onnx", states)


def test_a_full_turn_does_not_change_the_outputs(tmp_path: Path) -> None:
    embedding = random_encoder("trig", (1,))
    export.export_onnx(embedding, tmp_path / "e.onnx")
    state = np.array([[700.0, 0.5, 0.1, 0.2], [700.0, 0.5 + 2 * np.pi, 0.1, 0.2]], np.float32)
    mu, _ = run(tmp_path / "e.onnx", state)
    np.testing.assert_allclose(mu[0], mu[1], atol=TOLERANCE)


def test_sigma_by_hand(tmp_path: Path) -> None:
    """One linear layer of one state: mu = 2 x + 1, rho = x; sigma = exp(rho) below 0 and rho + 1 above; then
    0.5 is taken off the mean, and all of it is doubled.
    """
    inputs = Inputs(("x",), ("m",), (), "raw", np.zeros(1), np.ones(1))
    layer = ([np.array([[2.0], [1.0]])], [np.array([1.0, 0.0])])
    embedding = Embedding(inputs, layer, layer, 0.0, LinearMap(np.array([[2.0]]), np.array([0.5])))
    export.export_onnx(embedding, tmp_path / "e.onnx")
    mu, sigma = run(tmp_path / "e.onnx", np.array([[-1.0], [0.0], [3.0]], np.float32))
    np.testing.assert_allclose(mu[:, 0], [-3.0, 1.0, 13.0], atol=1e-6)
    np.testing.assert_allclose(sigma[:, 0], [2 * np.exp(-1.0), 2.0, 8.0], atol=1e-6)


def test_the_file_has_metadata(embedding: Embedding, tmp_path: Path) -> None:
    export.export_onnx(embedding, tmp_path / "deep" / "e.onnx")
    model = onnx.load(tmp_path / "deep" / "e.onnx")
    assert {p.key: p.value for p in model.metadata_props} == {
        "state_names": json.dumps(["slider", "hinge", "slidervel", "hingevel"]),
        "state_units": json.dumps(["m", "rad", "m/s", "rad/s"]),
        "z_dim": "3",
        "embedding_hash": embedding.hash,
        "planspace_version": planspace.__version__,
    }
    assert [f.name for f in (tmp_path / "deep").iterdir()] == ["e.onnx"]


def test_an_existing_file_is_not_overwritten(embedding: Embedding, tmp_path: Path) -> None:
    (tmp_path / "e.onnx").write_text("mine")
    with pytest.raises(PlanspaceError, match=r"e\.onnx exists already; choose another file"):
        export.export_onnx(embedding, tmp_path / "e.onnx")
    assert (tmp_path / "e.onnx").read_text() == "mine"


def test_a_model_with_other_outputs_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    embedding = random_encoder("trig", (1,))
    bias = embedding.encoder[1][-1] + np.float32(1e-4)
    wrong = replace(embedding, encoder=(embedding.encoder[0], [*embedding.encoder[1][:-1], bias]))
    build = export._build
    monkeypatch.setattr(export, "_build", lambda onnx, _: build(onnx, wrong))
    with pytest.raises(PlanspaceError, match=r"mu is off by [\d.]+e-0[45], where 1e-05 is allowed") as caught:
        export.export_onnx(embedding, tmp_path / "e.onnx")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_model_with_outputs_that_are_not_finite_is_not_written(tmp_path: Path) -> None:
    embedding = random_encoder("raw", ())
    embedding.encoder[1][-1][0] = np.nan
    with pytest.raises(PlanspaceError, match="mu is off by nan"):
        export.export_onnx(embedding, tmp_path / "e.onnx")


@pytest.mark.parametrize("missing", ["onnx", "onnxruntime"])
def test_missing_packages(
    missing: str, embedding: Embedding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    if missing == "onnx":
        with pytest.raises(PlanspaceError, match=r"^[^\n]*pip install .*\[onnx\]'\.$"):
            export.export_onnx(embedding, tmp_path / "e.onnx")
    else:  # without onnxruntime the file is written, but not compared
        export.export_onnx(embedding, tmp_path / "e.onnx")
    assert (tmp_path / "e.onnx").exists() == (missing == "onnxruntime")


def test_importing_the_module_needs_no_onnx() -> None:
    code = (
        "import sys, planspace.embed.export; print([m for m in ('onnx', 'onnxruntime') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
