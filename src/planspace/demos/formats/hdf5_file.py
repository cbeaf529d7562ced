"""Checked reading of HDF5 files (extra `data`).

An HDF5 file can link to other files, keep arrays in other files, declare huge arrays that take no space on
disk, and contain chunks that expand without limit. No recorder writes such files, so they are rejected.
"""

import math
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from planspace.errors import PlanspaceError, install_command, quoted
from planspace.storage.checks import MAX_BYTES, MAX_JSON_BYTES, check_file, explain_library_read

MAX_EXPANSION = 1032
"""Most bytes that one byte of deflate expands to: 258 bytes for two bits. Other filters of HDF5 give less."""
MAX_EPISODE_BYTES = MAX_BYTES // 8
"""Largest array of one demonstration; several copies of it exist at the same time."""
DEFLATE, SHUFFLE, FLETCHER32 = 1, 2, 3
"""HDF5's numbers of the filters that are read. Only the first changes the size of a chunk."""
CHECKSUM_BYTES = 4
"""Bytes that `FLETCHER32` appends to a chunk."""


def hdf5_module() -> ModuleType:
    """Import h5py.

    Raises:
        PlanspaceError: it is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise PlanspaceError(f"HDF5 files need the package h5py: {install_command('data')}.") from error
    return h5py


@contextmanager
def open_hdf5(file: Path) -> Iterator[Any]:
    """Open an HDF5 file for reading, after a check that it refers to no other files.

    Args:
        file: the file, given by the user.

    Yields:
        The `h5py.File`. Read its arrays with `read_rows`, and its attributes with `read_text` and
        `read_numbers`.

    Raises:
        PlanspaceError: h5py is not installed, or the file cannot be read or contains links. Errors of HDF5
            inside the block are also turned into this error.
    """
    h5py = hdf5_module()
    check_file(file, may_be_link=True)
    with explain_library_read(file, "HDF5"), h5py.File(file, "r") as opened:
        check_references(opened, file)
        yield opened


def check_references(
    opened: Any, file: Path, check_array: Callable[[bytes, Any], str | None] = lambda name, array: None
) -> None:
    """Check that an HDF5 file contains no links and no arrays in other files.

    Args:
        opened: the `h5py.File`.
        file: its path, for messages.
        check_array: another check of each array, given its name and h5py's `DatasetID`; returns what is
            wrong.

    Raises:
        PlanspaceError: the file contains them, or an object has two names.
    """
    from h5py import h5d, h5l, h5o

    def wrong_link(name: bytes, link: Any) -> str | None:
        return None if link.type == h5l.TYPE_HARD else f"{_name(name)} is a link"

    def wrong_object(name: bytes, item: Any) -> str | None:
        if item.rc != 1:  # nested groups with two names each would be read 2^depth times
            return f"{_name(name)} has two names"
        if item.type != h5o.TYPE_DATASET:
            return None
        array = h5d.open(opened.id, name)
        layout = array.get_create_plist()
        if layout.get_layout() == h5d.VIRTUAL or layout.get_external_count():
            return f"{_name(name)} keeps its numbers in another file"
        return check_array(name, array)

    # h5py does not allow errors in callbacks
    wrong = opened.id.links.visit(wrong_link, info=True) or h5o.visit(opened.id, wrong_object, info=True)
    if wrong:
        raise PlanspaceError(f"{file}: {wrong}; planspace does not read such files.")


def find_array(group: Any, key: str, kinds: str = "iufb") -> Any:
    """An array of numbers in a group, as an `h5py.Dataset`, or None if the group has no array of this name.

    Args:
        group: the group.
        key: the name of the array.
        kinds: the accepted kinds of NumPy types; by default numbers.

    Raises:
        PlanspaceError: the array has no rows of numbers, is compressed with an unknown filter, or contains
            more than it declares; the message names it.
    """
    found = group.get(key)
    if not isinstance(found, hdf5_module().Dataset):
        return None
    where = f"{found.file.filename}: {found.name[1:]!r}"
    if found.dtype.kind not in kinds or not found.shape:
        kind = "references or texts" if found.dtype.kind == "O" else f"type {found.dtype}"
        wanted = "texts of fixed length" if kinds == "S" else "rows of numbers"
        raise PlanspaceError(f"{where} must contain {wanted}, got {kind} of shape {found.shape}.")
    most = min(MAX_BYTES, MAX_EXPANSION * Path(found.file.filename).stat().st_size)
    if _num_bytes(found.shape, found.dtype) > most:
        raise PlanspaceError(
            f"{where} declares an array of shape {found.shape}, more than the {most} bytes that can be read."
        )
    _check_chunks(found, where)
    return found


def read_rows(array: Any, start: int = 0, stop: int | None = None) -> Float[np.ndarray, "row ..."]:
    """Read rows of an array that `find_array` returned, as floats.

    Raises:
        PlanspaceError: the rows do not fit in memory.
    """
    last: int = array.shape[0] if stop is None else stop
    if 8 * (last - start) * math.prod(array.shape[1:]) > MAX_EPISODE_BYTES:
        raise PlanspaceError(
            f"{array.file.filename}: {last - start} rows of {array.name[1:]!r} do not fit in memory."
        )
    return np.asarray(array[start:last]).astype(float)


def read_names(group: Any, key: str) -> list[str]:
    """The texts in an array of texts of fixed length.

    Raises:
        PlanspaceError: there is no such array, or its texts have no fixed length.
    """
    array = find_array(group, key, "S")
    if array is None or len(array.shape) != 1:
        raise PlanspaceError(f"{group.file.filename}: {key!r} must be a list of names.")
    return [name.decode(errors="replace") for name in array[:]]


def read_text(item: Any, key: str) -> str | None:
    """An attribute that is one text, or None if there is no such attribute.

    Raises:
        PlanspaceError: the attribute is not one text, or not in UTF-8.
    """
    if key not in item.attrs:
        return None
    where = f"{item.file.filename}: the attribute {key!r} of {item.name[1:]!r}"
    attribute = item.attrs.get_id(key)
    if attribute.shape != () or attribute.get_type().get_class() != _text_class():
        raise PlanspaceError(f"{where} must be a text.")
    value = item.attrs[key]
    try:
        data = value if isinstance(value, bytes) else str(value).encode()
        if len(data) > MAX_JSON_BYTES:
            raise PlanspaceError(f"{where} has {len(data)} bytes; at most {MAX_JSON_BYTES} can be read.")
        return data.decode()
    except UnicodeError as error:
        raise PlanspaceError(f"{where} is not UTF-8 text.") from error


def read_numbers(item: Any, key: str) -> Shaped[np.ndarray, "..."] | None:
    """An attribute that is a number or an array of numbers, or None if there is no such attribute.

    Raises:
        PlanspaceError: the attribute does not consist of numbers.
    """
    if key not in item.attrs:
        return None
    if item.attrs.get_id(key).dtype.kind not in "iufb":
        raise PlanspaceError(
            f"{item.file.filename}: the attribute {key!r} of {item.name[1:]!r} must be a number."
        )
    return np.asarray(item.attrs[key])


def _check_chunks(array: Any, where: str) -> None:
    """Check that each compressed chunk expands to its declared size: HDF5 itself expands it to any size."""
    layout = array.id.get_create_plist()
    filters = [layout.get_filter(i) for i in range(layout.get_nfilters())]
    codes = [code for code, *_ in filters]
    if set(codes) - {DEFLATE, SHUFFLE, FLETCHER32} or len(set(codes)) < len(codes):
        names = ", ".join(quoted(name.decode(errors="replace")) for *_, name in filters)
        raise PlanspaceError(
            f"{where} is compressed with {names}; planspace reads gzip only: rewrite the file with "
            "`h5repack -f GZIP=4 OLD NEW`."
        )
    if DEFLATE not in codes:
        return
    size = _num_bytes(array.chunks, array.dtype) + CHECKSUM_BYTES
    if size > MAX_EPISODE_BYTES:
        raise PlanspaceError(f"{where} has chunks of {size} bytes, which do not fit in memory.")
    chunks: list[Any] = []
    array.id.chunk_iter(chunks.append)
    for chunk in chunks:
        if chunk.size > 2 * size + 1024:  # deflate makes nothing larger than that
            raise PlanspaceError(f"{where} has a chunk that is larger than it declares.")
        _, data = array.id.read_direct_chunk(chunk.chunk_offset)
        if chunk.filter_mask & (1 << codes.index(DEFLATE)):  # left as it is, because it does not shrink
            continue
        try:
            expanded = zlib.decompressobj().decompress(data, size + 1)
        except zlib.error as error:
            raise PlanspaceError(f"{where} is damaged ({error}).") from error
        if len(expanded) > size:
            raise PlanspaceError(f"{where} has a chunk that expands to more than it declares.")


def _num_bytes(shape: tuple[int, ...], dtype: np.dtype) -> int:
    return math.prod(shape) * dtype.itemsize


def _text_class() -> int:
    from h5py import h5t

    return h5t.STRING


def _name(name: bytes) -> str:
    return repr(name.decode(errors="replace"))
