"""What the wrappers' constructors share: the embedding, and arguments that a spec can record as JSON."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import VectorWrapper

from planspace.embed.embedding import Embedding
from planspace.embed.saved_embedding import load_embedding

if TYPE_CHECKING:
    VectorWrapperBase = VectorWrapper[Any, Any, Any, Any, Any]
else:
    VectorWrapperBase = VectorWrapper  # generic only since Gymnasium 1.3


def embedding_from(given: str | Path | Embedding) -> Embedding:
    """Return an embedding, loading it if a folder is given.

    Raises:
        PlanspaceError: the embedding cannot be loaded.
        UsageError: the argument is neither a folder nor an embedding.
    """
    return given if isinstance(given, Embedding) else load_embedding(given)


def recorded(**arguments: Any) -> dict[str, Any]:
    """Return constructor arguments as plain data, so that an environment's spec can be saved as JSON.

    An embedding is recorded as it is: a spec that holds one makes the same environment in this process, but
    JSON cannot hold it. Pass the embedding's folder where the spec is saved.
    """
    return {name: _plain(value) for name, value in arguments.items()}


def rows_of(info: Mapping[str, Any], rows: np.ndarray) -> dict[str, Any]:
    """Return the entries of some environments from the arrays in a vector environment's info."""
    return {name: values[rows] for name, values in info.items() if isinstance(values, np.ndarray)}


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return value
