"""Checks of the files of a Minari dataset before Minari reads them.

An HDF5 file can link to other files, keep arrays in other files, and declare huge arrays that take no space
on disk. No recorder writes such files, so they are rejected.
"""

import math
from collections import Counter
from pathlib import Path
from typing import Any

from planspace.errors import PlanspaceError
from planspace.storage.checks import MAX_BYTES, MAX_JSON_BYTES, check_file, explain_read

HDF5 = "main_data.hdf5"
"""The file with the episodes of a dataset in HDF5 format."""
MAX_EXPANSION = 1032
"""Most bytes that one byte of deflate expands to: 258 bytes for two bits. Other filters of HDF5 give less."""


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
    from h5py import h5d, h5l, h5o

    most = min(MAX_BYTES, MAX_EXPANSION * file.stat().st_size)
    declared: Counter[bytes] = Counter()

    def wrong_link(name: bytes, link: Any) -> str | None:
        return None if link.type == h5l.TYPE_HARD else f"{_text(name)} is a link"

    def wrong_object(name: bytes, item: Any) -> str | None:
        if item.rc != 1:  # nested groups with two names each would be read 2^depth times
            return f"{_text(name)} has two names"
        if item.type != h5o.TYPE_DATASET:
            return None
        array = h5d.open(opened.id, name)
        layout = array.get_create_plist()
        if layout.get_layout() == h5d.VIRTUAL or layout.get_external_count():
            return f"{_text(name)} keeps its numbers in another file"
        episode = name.partition(b"/")[0]
        declared[episode] += math.prod(array.shape or ()) * array.get_type().get_size()
        if declared[episode] > most:
            return f"{_text(name)} makes its episode larger than {most} bytes, the most that can be read"
        return None

    with explain_read(file), h5py.File(file, "r") as opened:  # h5py does not allow errors in callbacks
        wrong = opened.id.links.visit(wrong_link, info=True) or h5o.visit(opened.id, wrong_object, info=True)
    if wrong:
        raise PlanspaceError(f"{file}: {wrong}; planspace does not read such files.")


def _text(name: bytes) -> str:
    return repr(name.decode(errors="replace"))
