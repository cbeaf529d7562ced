"""Checks of the files of a Minari dataset before Minari reads them.

An HDF5 file can link to other files, keep arrays in other files, and declare huge arrays that take no space
on disk. No recorder writes such files, so they are rejected.
"""

import math
from collections import Counter
from pathlib import Path
from typing import Any

from planspace.demos.formats.hdf5_file import MAX_EXPANSION, check_references
from planspace.errors import PlanspaceError
from planspace.storage.checks import MAX_BYTES, MAX_JSON_BYTES, check_file, explain_read

HDF5 = "main_data.hdf5"
"""The file with the episodes of a dataset in HDF5 format."""


def check_files(folder: Path) -> None:
    """Check that a dataset refers to no other files and declares no more data than its files can contain.

    Args:
        folder: the folder of the dataset; it may itself be a link.

    Raises:
        PlanspaceError: a file violates this, is not a regular file, or cannot be read.
    """
    for path in folder.rglob("*"):
        if path.is_symlink():
            raise PlanspaceError(
                f"{path} is a link to {path.readlink()}; replace it by a copy of the target."
            )
        if path.suffix == ".json":
            check_file(path, most=MAX_JSON_BYTES)
        elif not path.is_dir():
            check_file(path)
        if path.name == HDF5:
            _check_hdf5(path)


def _check_hdf5(file: Path) -> None:
    import h5py

    most = min(MAX_BYTES, MAX_EXPANSION * file.stat().st_size)
    declared: Counter[bytes] = Counter()

    def too_large(name: bytes, array: Any) -> str | None:
        episode = name.partition(b"/")[0]
        declared[episode] += math.prod(array.shape or ()) * array.get_type().get_size()
        if declared[episode] <= most:
            return None
        text = repr(name.decode(errors="replace"))
        return f"{text} makes its episode larger than {most} bytes, the most that can be read"

    with explain_read(file), h5py.File(file, "r") as opened:
        check_references(opened, file, too_large)
