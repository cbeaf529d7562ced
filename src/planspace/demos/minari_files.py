"""What the files of a Minari dataset may hold, seen before Minari reads them.

HDF5 has names that stand for other files, arrays that are kept in other files, and arrays that take no room
until they are read. No recorder makes the first two, and none makes the third as large as they can be.
"""

import math
from collections import Counter
from pathlib import Path
from typing import Any

from planspace.errors import PlanspaceError
from planspace.storage.checks import MAX_BYTES, MAX_JSON_BYTES, check_file, explain_read

HDF5 = "main_data.hdf5"
"""Where Minari keeps the episodes, in this format."""
MOST_IN_A_BYTE = 1032
"""Bytes that one of deflate's becomes at most: 258 for two bits; HDF5's other filters do less."""


def check_files(folder: Path) -> None:
    """Sees that nothing in a dataset leads out of it, and nothing takes more memory than its file could hold.

    Args:
        folder: the dataset's; it may itself be a link.

    Raises:
        PlanspaceError: something does; or is no plain file; or cannot be read.
    """
    for path in folder.rglob("*"):
        if path.is_symlink():
            raise PlanspaceError(
                f"{path} is a link, to {path.readlink()}; put a copy of what it leads to in its place."
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

    most = min(MAX_BYTES, MOST_IN_A_BYTE * file.stat().st_size)
    declared: Counter[bytes] = Counter()

    def wrong_link(name: bytes, link: Any) -> str | None:
        return None if link.type == h5l.TYPE_HARD else f"{_text(name)} is a link"

    def wrong_object(name: bytes, item: Any) -> str | None:
        if item.rc != 1:  # groups within groups with two names each would be read 2^depth times
            return f"{_text(name)} has a second name"
        if item.type != h5o.TYPE_DATASET:
            return None
        array = h5d.open(opened.id, name)
        layout = array.get_create_plist()
        if layout.get_layout() == h5d.VIRTUAL or layout.get_external_count():
            return f"{_text(name)} keeps its numbers in another file"
        episode = name.partition(b"/")[0]
        declared[episode] += math.prod(array.shape or ()) * array.get_type().get_size()
        if declared[episode] > most:
            return f"{_text(name)} makes its episode larger than the {most} bytes that can be read"
        return None

    with explain_read(file), h5py.File(file, "r") as opened:  # h5py wants no errors raised while it walks
        wrong = opened.id.links.visit(wrong_link, info=True) or h5o.visit(opened.id, wrong_object, info=True)
    if wrong:
        raise PlanspaceError(f"{file}: {wrong}; planspace does not take that.")


def _text(name: bytes) -> str:
    return repr(name.decode(errors="replace"))
