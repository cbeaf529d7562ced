"""Export an embedding's encoder as an ONNX file, for programs without Python (extra `onnx`).

The graph, for states x [batch, n] in float32:

    features    x as it is; for `trig`, the other columns, then sin and cos of the circular ones
    centred     features - mean; the mean is subtracted in two float32 parts
    h           ReLU layers; 1 / std is folded into the first weights
    mu, sigma   linear; ELU of a linear layer, + 1 (equation 12); then the embedding's linear map

The mean is not folded into the first bias: that would lose digits where a state is large compared with its
standard deviation. Angles are not wrapped: the runtime's sin and cos are exact to 1e-7 at any angle.
"""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

import planspace
from planspace.embed.embedding import Embedding, LinearMap
from planspace.errors import PlanspaceError
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
        self.constants.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def linear(self, x: str, weight: np.ndarray, bias: np.ndarray, name: str) -> str:
        """Add a linear layer with weight [out, in] and bias [out]; only here are they rounded to float32."""
        w = self.constant(f"{name}.weight", weight.astype(np.float32))
        b = self.constant(f"{name}.bias", bias.astype(np.float32))
        return self.node("Gemm", x, w, b, name=name, transB=1)


def _build(onnx: ModuleType, embedding: Embedding) -> Any:
    graph = _Graph(onnx)
    weights = [w.astype(np.float64) for w in embedding.encoder[0]]
    biases = [b.astype(np.float64) for b in embedding.encoder[1]]
    x, order = _features(graph, embedding)
    x = _centred(graph, x, embedding.inputs.mean[order])
    weights[0] = weights[0][:, order] / embedding.inputs.std[order]
    for i in range(len(weights) - 1):
        x = graph.node("Relu", graph.linear(x, weights[i], biases[i], f"layer{i}"), name=f"relu{i}")
    z = embedding.z_dim
    linear_map = embedding.linear_map or LinearMap(np.eye(z), np.zeros(z))
    matrix = linear_map.matrix.astype(np.float64)
    graph.linear(x, matrix.T @ weights[-1][:z], (biases[-1][:z] - linear_map.centre) @ matrix, OUTPUTS[0])
    rho = graph.linear(x, weights[-1][z:], biases[-1][z:], "rho")
    one = graph.constant("one", np.ones(1, np.float32))
    sigma = graph.node("Add", graph.node("Elu", rho, name="elu"), one, name="latent_sigma")
    variance = graph.node("Mul", sigma, sigma, name="latent_variance")
    squares = graph.constant("turn.squares", (matrix**2).astype(np.float32))
    graph.node("Sqrt", graph.node("MatMul", variance, squares, name="variance"), name=OUTPUTS[1])
    return _model(onnx, graph, embedding)


def _features(graph: _Graph, embedding: Embedding) -> tuple[str, np.ndarray]:
    """Add the inputs before standardising, grouped; return their name and the index of each in `Inputs`."""
    inputs = embedding.inputs
    if inputs.form != "trig" or not inputs.circular_columns:
        return INPUT, np.arange(embedding.state_dim)
    circular = np.array(sorted(inputs.circular_columns))
    straight = np.setdiff1d(np.arange(embedding.state_dim), circular)
    places = {column: inputs.columns.index(column) for column in range(embedding.state_dim)}
    angles = graph.node("Gather", INPUT, graph.constant("circular", circular), name="angles", axis=1)
    parts = [graph.node("Sin", angles, name="sin"), graph.node("Cos", angles, name="cos")]
    sines = [places[c] for c in circular]
    order = [*sines, *(place + 1 for place in sines)]
    if len(straight):
        columns = graph.constant("straight", straight)
        parts.insert(0, graph.node("Gather", INPUT, columns, name="numbers", axis=1))
        order = [*(places[c] for c in straight), *order]
    return graph.node("Concat", *parts, name="features", axis=1), np.array(order)


def _centred(graph: _Graph, x: str, mean: Float[np.ndarray, " input"]) -> str:
    if not mean.any():
        return x
    high = mean.astype(np.float32)
    low = (mean - high).astype(np.float32)
    x = graph.node("Sub", x, graph.constant("mean.high", high), name="centred.high")
    return graph.node("Sub", x, graph.constant("mean.low", low), name="centred")


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
    """Draw random float32 states: angles over several turns, other numbers distributed as in training."""
    inputs, rng = embedding.inputs, np.random.default_rng(0)
    states = rng.normal(size=(NUM_CHECKED, embedding.state_dim))
    for column in range(embedding.state_dim):
        place = inputs.columns.index(column)
        if inputs.form == "trig" and column in inputs.circular_columns:
            turns = CHECKED_TURNS * 2 * np.pi
            states[:, column] = rng.uniform(-turns, turns, NUM_CHECKED)
        else:
            states[:, column] = inputs.mean[place] + inputs.std[place] * states[:, column]
    return states.astype(np.float32)


def _onnx() -> ModuleType:
    try:
        import onnx
        import onnx.checker
        import onnx.helper
        import onnx.numpy_helper
    except ImportError as error:
        raise PlanspaceError("ONNX files need the package onnx: pip install 'planspace[onnx]'.") from error
    return onnx
