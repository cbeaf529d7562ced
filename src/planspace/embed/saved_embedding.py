"""An embedding as a folder.

    DIR/embedding.safetensors   the weights and the normaliser
    DIR/embedding.json          what they mean: inputs, architecture, preset, seed, metrics, provenance
    DIR/README.md, log.jsonl    model card and training log, written by `fit_embedding`

The JSON contains its own checksum and the SHA-256 of the weights. Loading imports neither JAX nor MuJoCo.
"""

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from planspace.embed.about import read_about
from planspace.embed.embedding import Embedding, LinearMap
from planspace.embed.inputs import INPUT_TYPES, Inputs, Quaternion
from planspace.embed.support import Support
from planspace.embed.time_head import ARCHITECTURE as TIME_ARCHITECTURE
from planspace.embed.time_head import TIME_INPUTS, TimeHead
from planspace.errors import PlanspaceError, UsageError, quoted
from planspace.storage.arrays import Arrays, read_arrays, write_arrays
from planspace.storage.checks import CONFIG, reject_malformed
from planspace.storage.files import make_folder
from planspace.storage.json_files import read_description, read_json, write_sealed
from planspace.storage.ready_made import EMBEDDING as READY_EMBEDDING
from planspace.storage.ready_made import find_folder

SCHEMA, ROTATION_SCHEMA = 2, 3
"""Files with quaternions have the second one, because earlier versions do not know them."""
WEIGHTS, DESCRIPTION = "embedding.safetensors", "embedding.json"
CARD, LOG = "README.md", "log.jsonl"
ARCHITECTURE = "relu-gaussian"
"""The only architecture: `embed.networks`. A file names it; it never names code."""


def save_embedding(embedding: Embedding, path: Path) -> None:
    """Save an embedding in a folder. The description is written last; without it there is no embedding.

    Raises:
        PlanspaceError: the folder already holds an embedding, or cannot be written.
    """
    if (path / DESCRIPTION).exists():
        raise PlanspaceError(f"{path} already holds an embedding; choose another --out.")
    make_folder(path)
    support, arrays = embedding.support, embedding.arrays()
    if support is not None:
        arrays |= {"support": support.points, "support_scale": support.scale}
    sha256 = write_arrays(path / WEIGHTS, arrays)
    inputs = embedding.inputs
    description = {
        "schema": ROTATION_SCHEMA if inputs.quaternions else SCHEMA,
        "kind": "embedding",
        "architecture": ARCHITECTURE,
        "weights_sha256": sha256,
        "inputs": {
            "names": inputs.names,
            "units": inputs.units,
            "circular_columns": inputs.circular_columns,
            "form": inputs.form,
            **({"quaternions": inputs.quaternions} if inputs.quaternions else {}),
        },
        "z_dim": embedding.z_dim,
        "sigma_floor": embedding.sigma_floor,
        "support_radius": None if support is None else support.radius,
        **_head_description(embedding.time_head),
        "about": {} if embedding.about is None else embedding.about.plain(),
    }
    write_sealed(path / DESCRIPTION, description)


def load_embedding(path: str | Path) -> Embedding:
    """Load an embedding that `planspace embed`, `fit_embedding` or `Embedding.save` wrote.

    Args:
        path: its folder, or the name of a ready-made one, such as `cartpole-swingup`.

    Raises:
        PlanspaceError: the folder is not an embedding, has a newer schema, or was altered since it was saved.
        UsageError: `path` is not a path, or neither a folder nor a ready-made embedding has this name.
    """
    if not isinstance(path, str | PathLike):
        raise UsageError(f"expected the path of an embedding's folder, got {path!r:.60}.")
    path = find_folder(path, READY_EMBEDDING)
    if not (path / DESCRIPTION).exists():
        if (path / CONFIG).exists() and "split_seed" in read_json(path / CONFIG):
            raise PlanspaceError(
                f"{path} is not finished: its training is running or was interrupted; repeat the command."
            )
        if path.name == DESCRIPTION and path.exists():
            raise PlanspaceError(f"{path} is part of an embedding; give its folder, {path.parent}.")
        raise PlanspaceError(f"{path} is not an embedding: it contains no {DESCRIPTION}.")
    text = read_description(path / DESCRIPTION, kind="embedding", schema=ROTATION_SCHEMA)
    with reject_malformed(path / DESCRIPTION):
        embedding = _assemble(path, text)
        _check_parts(embedding, text["z_dim"])
    return embedding


def _assemble(path: Path, text: dict[str, Any]) -> Embedding:
    if text["architecture"] != ARCHITECTURE:
        raise PlanspaceError(
            f"{path / DESCRIPTION} names the architecture {quoted(text['architecture'])}; this planspace "
            f"only knows {ARCHITECTURE!r}."
        )
    arrays = read_arrays(path / WEIGHTS, sha256=str(text["weights_sha256"]))
    if any(array.dtype.kind != "f" for array in arrays.values()):
        raise TypeError("its weights are not floating point numbers")
    bad = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    if bad:
        raise PlanspaceError(f"{path / WEIGHTS}: {bad[0]} contains a number that is not finite.")
    support = None
    if "support" in arrays:
        support = Support(arrays["support"], arrays["support_scale"], float(text["support_radius"]))
    linear_map = None
    if "turn.matrix" in arrays:
        linear_map = LinearMap(arrays["turn.matrix"], arrays["turn.centre"])
    inputs = {key: text["inputs"][key] for key in ("names", "units", "circular_columns")}
    if not all(isinstance(name, str) for name in (*inputs["names"], *inputs["units"])):
        raise TypeError("the names of its inputs are not strings")
    return Embedding(
        inputs=Inputs(
            **{key: tuple(value) for key, value in inputs.items()},
            form=INPUT_TYPES[INPUT_TYPES.index(text["inputs"]["form"])],
            mean=arrays["mean"],
            std=arrays["deviation"],
            quaternions=_quaternions(text["inputs"]),
        ),
        encoder=_layers(arrays, "encoder"),
        decoder=_layers(arrays, "decoder"),
        sigma_floor=float(text["sigma_floor"]),
        linear_map=linear_map,
        support=support,
        time_head=_time_head(path, text, arrays),
        about=read_about(text["about"]),
    )


@np.errstate(all="ignore")  # the function itself checks for numbers that are not finite
def _check_parts(embedding: Embedding, z_dim: int) -> None:
    """Check that the parts fit together and match the description."""
    inputs, layers = embedding.inputs, (*embedding.encoder[0], *embedding.decoder[0])
    columns = (*inputs.circular_columns, *(c for quaternion in inputs.quaternions for c in quaternion))
    if not all(type(column) is int and 0 <= column < len(inputs.names) for column in columns):
        raise ValueError("an angle or a part of a quaternion is not a column of the state")
    if inputs.quaternions and len(set(columns)) < len(columns):
        raise ValueError("a column of the state is part of two angles or quaternions")
    if embedding.about is not None and embedding.about.seed not in embedding.about.settings.seeds:
        raise ValueError("its selected seed is not one of the trained seeds")
    if not layers or len(inputs.units) != len(inputs.names) or not (inputs.std > 0).all():
        raise ValueError("its inputs or its networks are incomplete")
    state = np.stack([np.zeros(len(inputs.names)), np.ones(len(inputs.names))])
    z = embedding.encode(state)
    decoded = embedding.decode(z)
    if z.shape != (2, z_dim) or decoded.shape != state.shape:
        raise ValueError("the sizes of its networks do not match its description")
    if not (np.isfinite(z).all() and np.isfinite(decoded).all()):
        raise ValueError("its networks give numbers that are not finite")
    if embedding.support is not None:
        embedding.outside_support(state)
    if embedding.time_head is not None and not np.isfinite(embedding.time_to_go(state, state[::-1])).all():
        raise ValueError("its time head gives numbers that are not finite")


def _quaternions(inputs: dict[str, Any]) -> tuple[Quaternion, ...]:
    return tuple((w, x, y, z) for w, x, y, z in inputs.get("quaternions", ()))


def _head_description(head: TimeHead | None) -> dict[str, Any]:
    """The entry of a time head; nothing if there is none, so that the file is as in earlier versions."""
    return {} if head is None else {"time_head": {"architecture": TIME_ARCHITECTURE, "reads": head.reads}}


def _time_head(path: Path, text: dict[str, Any], arrays: Arrays) -> TimeHead | None:
    if "time_head" not in text:
        return None
    named = text["time_head"]["architecture"]
    if named != TIME_ARCHITECTURE:
        raise PlanspaceError(
            f"{path / DESCRIPTION} names the time head {quoted(named)}; this planspace only knows "
            f"{TIME_ARCHITECTURE!r}."
        )
    weights, biases = _layers(arrays, "time_head")
    if not weights:
        raise ValueError("its time head has no weights")
    return TimeHead(weights, biases, TIME_INPUTS[TIME_INPUTS.index(text["time_head"]["reads"])])


def _layers(arrays: Arrays, name: str) -> tuple[list[np.ndarray], list[np.ndarray]]:
    count = sum(key.startswith(f"{name}.") for key in arrays) // 2
    return (
        [arrays[f"{name}.{i}.weight"] for i in range(count)],
        [arrays[f"{name}.{i}.bias"] for i in range(count)],
    )
