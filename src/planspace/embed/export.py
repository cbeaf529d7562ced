"""Export an embedding's encoder as an ONNX file, for programs without Python (extra `onnx`).

The graph computes what `float32_encoder` describes, for states [batch, n] in float32.
"""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

import planspace
from planspace.embed.embedding import Embedding
from planspace.embed.float32_encoder import Float32Encoder, Layer, float32_encoder
from planspace.errors import PlanspaceError, install_command
from planspace.physics.quaternion import rotation_columns
from planspace.storage.files import make_folder, write_bytes

OPSET, IR_VERSION = 17, 8
"""ONNX 1.12 (2022): old enough for most installed runtimes, new enough for the graph."""
TOLERANCE = 1e-5
"""Largest error of the exported outputs, relative to max(1, |ours|)."""
NUM_CHECKED = 64
CHECKED_TURNS = 3
"""Number of states that the file is tested on, and the largest number of turns of their angles."""
INPUT, OUTPUTS = "state", ("mu", "sigma")


def export_onnx(embedding: Embedding, path: Path) -> None:
    """Write q(z|x) as an ONNX model: `state` [batch, n] to `mu` [batch, z] and `sigma` [batch, z], float32.

    If onnxruntime is installed, the model is run and compared with the embedding before it is written.

    Args:
        embedding: the embedding; its decoder is not exported.
        path: the file to write.

    Raises:
        PlanspaceError: the package `onnx` is missing, the file exists or cannot be written, or the exported
            model computes other values than the embedding.
    """
    onnx = _onnx()
    if path.exists():
        raise PlanspaceError(f"{path} exists already; choose another file, or remove it first.")
    model = _build(onnx, embedding)
    onnx.checker.check_model(model, full_check=True)
    data = model.SerializeToString()
    _compare(embedding, data)
    make_folder(path.parent)
    write_bytes(path, data)


class _Graph:
    """A graph under construction; each method adds a node or constant and returns the name of its result."""

    def __init__(self, onnx: ModuleType):
        self._onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def node(self, operator: str, *inputs: str, name: str, **attributes: Any) -> str:
        self.nodes.append(self._onnx.helper.make_node(operator, inputs, [name], name=name, **attributes))
        return name

    def constant(self, name: str, value: np.ndarray) -> str:
        if any(constant.name == name for constant in self.constants):
            return name
        self.constants.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def linear(self, x: str, layer: Layer, name: str) -> str:
        weight, bias = layer
        w = self.constant(f"{name}.weight", weight)
        b = self.constant(f"{name}.bias", bias)
        return self.node("Gemm", x, w, b, name=name, transB=1)


def _build(onnx: ModuleType, embedding: Embedding) -> Any:
    graph, encoder = _Graph(onnx), float32_encoder(embedding)
    x = _features(graph, encoder)
    if encoder.mean.any():
        x = graph.node("Sub", x, graph.constant("mean", encoder.mean), name="centred")
    for i, layer in enumerate(encoder.hidden):
        x = graph.node("Relu", graph.linear(x, layer, f"layer{i}"), name=f"relu{i}")
    graph.linear(x, encoder.mu, OUTPUTS[0])
    rho = graph.linear(x, encoder.rho, "rho")
    one = graph.constant("one", np.ones(1, np.float32))
    sigma = graph.node("Add", graph.node("Elu", rho, name="elu"), one, name="latent_sigma")
    variance = graph.node("Mul", sigma, sigma, name="latent_variance")
    matrix = np.eye(embedding.z_dim) if embedding.linear_map is None else embedding.linear_map.matrix
    squares = graph.constant("turn.squares", (matrix.astype(np.float64) ** 2).astype(np.float32))
    graph.node("Sqrt", graph.node("MatMul", variance, squares, name="variance"), name=OUTPUTS[1])
    return _model(onnx, graph, embedding)


def _features(graph: _Graph, encoder: Float32Encoder) -> str:
    """Add the inputs before standardising; return their name."""
    parts = []

    def gather(columns: np.ndarray, of: str, name: str) -> str:
        return graph.node("Gather", INPUT, graph.constant(of, columns), name=name, axis=1)

    if len(encoder.circular):
        angles = gather(encoder.circular, "circular", "angles")
        parts += [graph.node("Sin", angles, name="sin"), graph.node("Cos", angles, name="cos")]
    if encoder.quaternions.size:
        numbers = [gather(row, f"columns_{n}", n) for n, row in zip("wxyz", encoder.quaternions, strict=True)]
        parts += [number.name for number in rotation_columns(*(_Number(graph, name) for name in numbers))]
    if not parts:
        return INPUT
    if len(encoder.straight):
        parts.insert(0, gather(encoder.straight, "straight", "numbers"))
    return graph.node("Concat", *parts, name="features", axis=1)


class _Number:
    """A result in a graph; arithmetic with it adds nodes."""

    def __init__(self, graph: _Graph, name: str):
        self._graph, self.name = graph, name

    def _with(self, operator: str, other: "_Number | float") -> "_Number":
        if not isinstance(other, _Number):
            constant = self._graph.constant(f"constant_{other:g}", np.array([other], np.float32))
            other = _Number(self._graph, constant)
        name = f"rotation_{len(self._graph.nodes)}"
        return _Number(self._graph, self._graph.node(operator, self.name, other.name, name=name))

    def __add__(self, other: "_Number | float") -> "_Number":
        return self._with("Add", other)

    def __sub__(self, other: "_Number") -> "_Number":
        return self._with("Sub", other)

    def __mul__(self, other: "_Number") -> "_Number":
        return self._with("Mul", other)

    def __truediv__(self, other: "_Number") -> "_Number":
        return self._with("Div", other)


def _model(onnx: ModuleType, graph: _Graph, embedding: Embedding) -> Any:
    def tensor(name: str, size: int) -> Any:
        return onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", size])

    whole = onnx.helper.make_graph(
        graph.nodes,
        "planspace-encoder",
        [tensor(INPUT, embedding.state_dim)],
        [tensor(name, embedding.z_dim) for name in OUTPUTS],
        graph.constants,
    )
    model = onnx.helper.make_model(
        whole,
        producer_name="planspace",
        producer_version=planspace.__version__,
        opset_imports=[onnx.helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    model.doc_string = "q(z|x): a state to the mean and standard deviation of its plan-space embedding."
    about = {
        "state_names": json.dumps(embedding.inputs.names),
        "state_units": json.dumps(embedding.inputs.units),
        "z_dim": str(embedding.z_dim),
        "embedding_hash": embedding.hash,
        "planspace_version": planspace.__version__,
    }
    onnx.helper.set_model_props(model, about)
    return model


def _compare(embedding: Embedding, data: bytes) -> None:
    """Compare the model's outputs with the embedding's, if onnxruntime is installed."""
    try:
        import onnxruntime
    except ImportError:
        return
    states = _probe_states(embedding)
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    ours = embedding.encode_distribution(states)
    theirs = session.run(list(OUTPUTS), {INPUT: states})
    for name, a, b in zip(OUTPUTS, ours, theirs, strict=True):
        error = float(np.max(np.abs(a - b) / np.maximum(1.0, np.abs(a))))
        if not error <= TOLERANCE:  # NaN is an error too
            raise PlanspaceError(
                f"the exported model's {name} is off by {error:.1e}, where {TOLERANCE:.0e} is allowed, so "
                "nothing was written: float32 has too few digits for these weights, as whitening a collapsed "
                "dimension makes them. Use load_embedding, or train with a smaller --whitening."
            )


def _probe_states(embedding: Embedding) -> Float[np.ndarray, "row state"]:
    """Draw random float32 states.

    Angles are uniform over several turns, quaternions have any sign and length, and other numbers are
    distributed as in training.
    """
    inputs, rng = embedding.inputs, np.random.default_rng(0)
    states = rng.normal(size=(NUM_CHECKED, embedding.state_dim))
    turns = CHECKED_TURNS * 2 * np.pi
    for i, (column, on_manifold) in enumerate(zip(inputs.columns, inputs.on_manifold, strict=True)):
        if not on_manifold:
            states[:, column] = inputs.mean[i] + inputs.std[i] * states[:, column]
        elif column in inputs.circular_columns and i == inputs.columns.index(column):
            states[:, column] = rng.uniform(-turns, turns, NUM_CHECKED)
    return states.astype(np.float32)


def _onnx() -> ModuleType:
    try:
        import onnx
        import onnx.checker
        import onnx.helper
        import onnx.numpy_helper
    except ImportError as error:
        raise PlanspaceError(f"ONNX files need the package onnx: {install_command('onnx')}.") from error
    return onnx
