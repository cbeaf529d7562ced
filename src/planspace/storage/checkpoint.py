"""Checkpoints of JAX trees: one safetensors file, replaced atomically."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from planspace.errors import PlanspaceError
from planspace.storage.arrays import read_arrays_and_metadata, write_arrays
from planspace.storage.files import make_folder

Tree = TypeVar("Tree")

FILE = Path("checkpoint") / "state.safetensors"


def save_checkpoint(folder: Path, tree: Any, counters: Mapping[str, int]) -> None:
    """Save the arrays of a tree as the checkpoint of a run.

    Args:
        folder: the run's folder.
        tree: any tree; leaves that are not arrays are not saved.
        counters: the run's progress, for example `{"step": 300}`.
    """
    make_folder((folder / FILE).parent)
    arrays = {name: np.asarray(leaf) for name, leaf in _named_leaves(tree).items()}
    write_arrays(folder / FILE, arrays, metadata=counters)


def load_checkpoint(folder: Path, like: Tree) -> tuple[Tree, dict[str, int]] | None:
    """Load the checkpoint of a run into a tree of the same structure.

    Args:
        folder: the run's folder.
        like: a tree with the structure of the saved one; its values do not matter, and shapes
            (`eqx.filter_eval_shape`) are enough.

    Returns:
        The tree and the counters, or None if there is no checkpoint.

    Raises:
        PlanspaceError: the checkpoint is damaged or has another structure.
    """
    path = folder / FILE
    if not path.exists():
        return None
    saved, counters = read_arrays_and_metadata(path)
    wanted = _named_leaves(like)
    for name, leaf in wanted.items():
        if name not in saved or saved[name].shape != leaf.shape or saved[name].dtype != leaf.dtype:
            raise PlanspaceError(
                f"{path} does not fit this run (array {name or 'without a name'}); remove {path.parent} to "
                "start over."
            )
    arrays, rest = eqx.partition(like, _is_array)
    leaves = [  # NumPy arrays stay NumPy arrays: JAX would convert float64 to float32
        saved[name] if isinstance(leaf, np.ndarray) else jnp.asarray(saved[name])
        for name, leaf in zip(wanted, jax.tree.leaves(arrays), strict=True)
    ]
    restored = jax.tree.unflatten(jax.tree.structure(arrays), leaves)
    return eqx.combine(restored, rest), counters


def _named_leaves(tree: Any) -> dict[str, Any]:
    arrays = eqx.filter(tree, _is_array)
    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree.leaves_with_path(arrays)}


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | jax.ShapeDtypeStruct)
