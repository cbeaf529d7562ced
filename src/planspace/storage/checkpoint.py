"""Checkpoints of JAX trees: one safetensors file, replaced in one step."""

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


def save_checkpoint(folder: Path, tree: Any, about: dict[str, Any]) -> None:
    """Saves the arrays of a tree and some plain data as a run's checkpoint.

    Args:
        folder: the run's folder.
        tree: any tree; what is not an array is not saved.
        about: plain data, for example the next step.
    """
    make_folder((folder / FILE).parent)
    arrays = {name: np.asarray(leaf) for name, leaf in _named_leaves(tree).items()}
    write_arrays(folder / FILE, arrays, metadata=about)


def load_checkpoint(folder: Path, like: Tree) -> tuple[Tree, dict[str, Any]] | None:
    """Loads a run's checkpoint into a tree of the same structure.

    Args:
        folder: the run's folder.
        like: a tree as it was when saved, of any values, or of shapes alone (`eqx.filter_eval_shape`).

    Returns:
        The tree and the plain data, or None if there is no checkpoint.

    Raises:
        PlanspaceError: the checkpoint is damaged or of another structure.
    """
    path = folder / FILE
    if not path.exists():
        return None
    saved, about = read_arrays_and_metadata(path)
    wanted = _named_leaves(like)
    for name, leaf in wanted.items():
        if name not in saved or saved[name].shape != leaf.shape or saved[name].dtype != leaf.dtype:
            raise PlanspaceError(
                f"{path} does not fit this run ({name or 'its only array'}); remove {path.parent} to "
                "start over."
            )
    arrays, rest = eqx.partition(like, _is_array)
    leaves = [  # NumPy stays NumPy: JAX would make float32 of float64
        saved[name] if isinstance(leaf, np.ndarray) else jnp.asarray(saved[name])
        for name, leaf in zip(wanted, jax.tree.leaves(arrays), strict=True)
    ]
    restored = jax.tree.unflatten(jax.tree.structure(arrays), leaves)
    return eqx.combine(restored, rest), about


def _named_leaves(tree: Any) -> dict[str, Any]:
    arrays = eqx.filter(tree, _is_array)
    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree.leaves_with_path(arrays)}


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | jax.ShapeDtypeStruct)
