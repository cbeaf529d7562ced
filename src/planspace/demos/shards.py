"""Shards: safetensors files with the arrays of some demonstrations, laid end to end."""

import math
from pathlib import Path

import numpy as np

from planspace.demos.manifest import MANIFEST, SHARD_NAME, Shard
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError
from planspace.storage.arrays import Arrays, read_arrays, write_arrays
from planspace.storage.checks import check_file, damage_error, reject_malformed

ARRAYS = ("states", "controls", "times", "offsets", "goals", "success", "indices", "seeds", "costs")
"""The arrays in a shard."""
HEADER_BYTES = 1 << 16
"""Upper bound on the size of a shard without its numbers."""


def write_shard(folder: Path, number: int, arrays: Arrays) -> Shard:
    """Write the arrays of some demonstrations.

    Args:
        folder: the folder of the dataset.
        number: number of the shard, starting at 0.
        arrays: the arrays named in `ARRAYS`.

    Returns:
        The entry for the manifest.
    """
    name = shard_name(number)
    sha256 = write_arrays(folder / name, {key: arrays[key] for key in ARRAYS})
    return Shard(name, sha256, episodes=len(arrays["offsets"]) - 1, states=len(arrays["states"]))


def read_shard(folder: Path, shard: Shard, info: StateInfo) -> Arrays:
    """Read and verify the arrays of a shard.

    Raises:
        PlanspaceError: the shard does not exist, was altered, or contradicts its entry in the manifest.
    """
    file = shard_file(folder, shard)
    most = HEADER_BYTES + 8 * sum(math.prod(shape) for shape in _shapes(shard, info).values())
    if not file.exists():
        raise PlanspaceError(
            f"{file} is missing. Restore it from a copy; or run `planspace repair {folder}`, and then the "
            "command that made the dataset."
        )
    check_file(file)
    if (size := file.stat().st_size) > most:
        raise damage_error(file, f"it has {size} bytes, its manifest allows at most {most}")
    arrays = read_arrays(file, sha256=shard.sha256)
    with reject_malformed(file):
        _check_arrays(arrays, shard, info)
    return {name: arrays[name] for name in ARRAYS}


def shard_file(folder: Path, shard: Shard) -> Path:
    """The path of a shard.

    Raises:
        PlanspaceError: its name in the manifest is not the name of a shard; it could lead to another folder.
    """
    with reject_malformed(folder / MANIFEST):
        if not SHARD_NAME.fullmatch(shard.file):
            raise ValueError(f"{shard.file!r} is not a valid shard name")
    return folder / shard.file


def shard_name(number: int) -> str:
    """The file name of a shard."""
    return f"shard-{number:05d}.safetensors"


def _shapes(shard: Shard, info: StateInfo) -> dict[str, tuple[int, ...]]:
    """The shapes that the arrays of a shard must have."""
    num, rows = shard.episodes, shard.states
    return {
        "states": (rows, len(info.names)),
        "controls": (rows - num, info.num_controls),
        "times": (rows,),
        "offsets": (num + 1,),
        "goals": (num, len(info.names)),
        **dict.fromkeys(("success", "indices", "seeds", "costs"), (num,)),
    }


def _check_arrays(arrays: Arrays, shard: Shard, info: StateInfo) -> None:
    for name, shape in _shapes(shard, info).items():
        kind = {"offsets": "i", "indices": "i", "seeds": "i", "success": "b"}.get(name, "f")
        if arrays[name].shape != shape or arrays[name].dtype.kind != kind:
            raise ValueError(f"{name} has shape {arrays[name].shape} and type {arrays[name].dtype}")
    offsets = arrays["offsets"]
    if offsets[0] != 0 or offsets[-1] != shard.states or not (np.diff(offsets) > 0).all():
        raise ValueError("its offsets do not cover its states")
    for name in ("states", "controls", "times"):
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} contains a number that is not finite")
