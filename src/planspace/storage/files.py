"""Files that survive: every write is atomic and durable, every read is checked.

A file is written under a temporary name in the same folder, flushed to disk, renamed, and the folder is
flushed too, so that a crash at any moment leaves the old file or the new one. Nothing here is pickled. What
is read must be a plain file, of a size that fits, and lie where it seems to lie; see `check_file`.
"""

import contextlib
import errno
import hashlib
import json
import os
import re
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

try:
    import fcntl
except ImportError:  # Windows: commands are trusted not to share a folder
    fcntl = None

from planspace.errors import PlanspaceError

Arrays = dict[str, np.ndarray]

TEMPORARY_PREFIX = ".writing-"
CHECKSUM_KEY = "checksum"
INNER = "planspace"
"""Where a safetensors file keeps what is said about its arrays."""
CONFIG = "config.json"
"""The settings a run was started with; see `open_run`."""
MAX_JSON_BYTES = 1 << 28
"""No description is larger: neither a manifest of a million shards nor a model with all its meshes."""
PART_OF_RUN = re.compile(r"checkpoint|embedding(-\d+)?")
"""Folders in a run's that are part of it."""
RUN_FILES = (CONFIG, "policies.json")
"""One of these lies in every run's folder."""


def _memory_bytes() -> int:
    """What this process may use: all of the machine's memory, or what its container is given."""
    try:
        most = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows
        return sys.maxsize
    with contextlib.suppress(OSError, ValueError):  # no container, or one without a limit
        most = min(most, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return most


MAX_BYTES = _memory_bytes() // 4
"""What is read in one piece is no larger: its parts are copied while they are checked and laid end to end."""


# --- one file ---------------------------------------------------------------------------------------


def write_bytes(path: Path, data: bytes) -> None:
    """Writes a file so that a crash leaves the old content or the new, never a part.

    Raises:
        PlanspaceError: the file cannot be written; what stood there before still stands.
    """
    temporary = path.parent / f"{TEMPORARY_PREFIX}{path.name}-{os.getpid()}"
    with _explain_write(path):
        try:
            with open(temporary, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
            _sync_folder(path.parent)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Writes a mapping as JSON, atomically."""
    write_bytes(path, _json_text(value))


def _json_text(value: Mapping[str, Any], indent: int | None = 2) -> bytes:
    return (json.dumps(value, indent=indent, allow_nan=False) + "\n").encode()


def read_json(path: Path) -> dict[str, Any]:
    """Reads a JSON object.

    Raises:
        PlanspaceError: the file is missing, unreadable or no JSON object.
    """
    data = read_bytes(path, most=MAX_JSON_BYTES)
    try:
        with within_memory(path):
            return _json_object(data)
    except (ValueError, RecursionError) as error:
        raise PlanspaceError(f"{path} is not valid JSON ({error}).") from error


def _json_object(data: bytes) -> dict[str, Any]:
    value = json.loads(data)
    if not isinstance(value, dict):
        raise ValueError(f"it should hold an object, got a {type(value).__name__}")
    return value


def read_bytes(path: Path, *, most: int = MAX_BYTES, may_be_link: bool = False) -> bytes:
    """Reads a whole file.

    Raises:
        PlanspaceError: it is missing or unreadable, or `check_file`, of the same arguments, refuses it.
    """
    check_file(path, most=most, may_be_link=may_be_link)
    with explain_read(path):
        return path.read_bytes()


def check_file(path: Path, *, most: int = sys.maxsize, may_be_link: bool = False) -> None:
    """Refuses what is not to be opened: a pipe or a device would never end, a link may lead anywhere.

    Args:
        path: the file.
        most: how many bytes it may have; any number where it is read piece by piece.
        may_be_link: whether it may be a link to a file elsewhere, as what the user names himself may be. What
            belongs to a folder of ours must lie in it; the folder itself may be a link.

    Raises:
        PlanspaceError: it is missing, no plain file, too large, or a link out of its folder.
    """
    if not may_be_link:
        _refuse_link_out(path)
        run = path.parent.parent
        if PART_OF_RUN.fullmatch(path.parent.name) and any((run / name).exists() for name in RUN_FILES):
            _refuse_link_out(path.parent)
    with explain_read(path):
        status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise PlanspaceError(f"cannot read {path}: it is no plain file.")
    if status.st_size > most:
        raise PlanspaceError(f"{path} has {status.st_size} bytes; at most {most} can be read here.")


def _refuse_link_out(path: Path) -> None:
    target, folder = os.path.realpath(path), path.parent
    if not Path(target).is_relative_to(os.path.realpath(folder)):
        raise PlanspaceError(f"{path} is a link out of its folder, to {target}; put a copy in its place.")


def write_sealed(path: Path, value: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """Writes a JSON object with a checksum of its own content; without an indent on one line."""
    write_bytes(path, _sealed_text(json.loads(json.dumps(value)), indent))


def _sealed_text(plain: dict[str, Any], indent: int | None) -> bytes:
    return _json_text({**plain, CHECKSUM_KEY: json_hash(plain)}, indent)


def read_sealed(path: Path) -> dict[str, Any]:
    """Reads a JSON object written by `write_sealed` and verifies that no byte of it is another.

    Raises:
        PlanspaceError: missing, not JSON, or altered since it was written.
    """
    data = read_bytes(path, most=MAX_JSON_BYTES)
    try:
        with within_memory(path):
            value = _json_object(data)
            value.pop(CHECKSUM_KEY, None)
            is_whole = data == _sealed_text(value, 2 if data.startswith(b"{\n") else None)
    except (ValueError, RecursionError) as error:  # numbers of too many digits, too
        raise damaged(path, f"it is not valid JSON: {error}") from error
    if not is_whole:
        raise damaged(path, "it does not match its own checksum")
    return value


def read_described(path: Path, *, kind: str, schema: int, name: str) -> dict[str, Any]:
    """Reads the sealed description of a folder of ours.

    Args:
        path: the file.
        kind: what the file must say that it describes.
        schema: the newest schema that is known.
        name: what it describes, for messages.

    Raises:
        PlanspaceError: altered, of another kind, or written by a newer planspace.
    """
    text = read_sealed(path)
    if text.get("kind") != kind:
        raise PlanspaceError(f"{path} describes no {name}.")
    if not isinstance(text.get("schema"), int):
        raise damaged(path, "it names no schema")
    if text["schema"] > schema:
        raise PlanspaceError(
            f"{path.parent} was written by a newer planspace (schema {text['schema']}, this one reads up to "
            f"{schema}); upgrade planspace."
        )
    return text


def write_arrays(path: Path, arrays: Arrays, *, about: Mapping[str, Any] | None = None) -> str:
    """Writes named arrays as one safetensors file, which holds a checksum of its own content.

    Args:
        path: the file.
        arrays: the arrays by name.
        about: plain data to keep in the same file, so that both change in one step.

    Returns:
        The SHA-256 of the file.
    """
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    inner = _inner_text(contiguous, json.loads(json.dumps(about)))
    data = safetensors.numpy.save(contiguous, metadata={INNER: inner})
    write_bytes(path, data)
    return hashlib.sha256(data).hexdigest()


def read_arrays(path: Path, *, sha256: str | None = None) -> Arrays:
    """Reads the arrays of a safetensors file.

    Args:
        path: the file.
        sha256: what its hash must be; None trusts the checksum in the file, which finds damage alone.

    Raises:
        PlanspaceError: missing, damaged, its hash is another, or one that `check_file` refuses.
    """
    with within_memory(path):
        return _read_arrays(path, sha256)[0]


def read_array(path: Path, name: str) -> np.ndarray:
    """Reads one array of a safetensors file that has been verified before, and no more of it.

    Raises:
        PlanspaceError: the file is missing or unreadable, or has no such array.
    """
    check_file(path, most=MAX_BYTES)
    try:
        with explain_read(path), safetensors.safe_open(path, framework="numpy") as file:
            return file.get_tensor(name)
    except safetensors.SafetensorError as error:
        raise damaged(path, f"no readable safetensors file ({error})") from error


def read_arrays_about(path: Path) -> tuple[Arrays, dict[str, Any]]:
    """Reads the arrays of a safetensors file, and the plain data that `write_arrays` kept with them.

    Raises:
        PlanspaceError: missing, damaged, or written without it.
    """
    with within_memory(path):
        arrays, about = _read_arrays(path, None)
    if not isinstance(about, dict):
        raise PlanspaceError(f"{path} does not hold the description expected in it.")
    return arrays, about


def _read_arrays(path: Path, sha256: str | None) -> tuple[Arrays, Any]:
    data = read_bytes(path)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
        raise damaged(path, "its SHA-256 is not the one recorded for it")
    try:
        arrays = safetensors.numpy.load(data)
        size = int.from_bytes(data[:8], "little")
        metadata = json.loads(data[8 : 8 + size]).get("__metadata__", {})
        if not metadata and sha256 is not None:  # of somebody else, who vouches for it
            return arrays, None
        about = json.loads(metadata[INNER])["about"]
        is_whole = metadata[INNER] == _inner_text(arrays, about)
    except (safetensors.SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise damaged(path, f"no readable safetensors file ({error})") from error
    if not is_whole:
        raise damaged(path, "it does not match its own checksum")
    return arrays, about


def _inner_text(arrays: Arrays, about: Any) -> str:
    return json.dumps({"about": about, CHECKSUM_KEY: _arrays_hash(arrays, about)}, sort_keys=True)


def _arrays_hash(arrays: Arrays, about: Any) -> str:
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def append_rows(path: Path, rows: Sequence[Mapping[str, Any]], *, number: str) -> None:
    """Appends JSON lines to a log and flushes them; where they do not fit, no part of them is left.

    A row that is there already is not appended again: what comes between a row and the checkpoint that counts
    it (an interrupt, a crash) has the row done once more, and the same.

    Args:
        path: the log.
        rows: in order of their numbers, at least one.
        number: the key of a row's number, which rises from row to row.

    Raises:
        PlanspaceError: it cannot be written, or `check_file` refuses it.
    """
    with _explain_write(path):
        new = not os.path.lexists(path)
        whole = b"" if new else _whole_lines(path)
        known = _numbers_from(rows[0][number], whole, number)
        lines = b"".join((json.dumps(row) + "\n").encode() for row in rows if row[number] not in known)
        try:
            with open(path, "ab", buffering=0) as file:
                if file.write(lines) != len(lines):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(file.fileno())  # without lines, too: an interrupt may have come before it
        except OSError:
            if path.exists():
                os.truncate(path, len(whole))
            raise
        if new:
            _sync_folder(path.parent)


def _whole_lines(path: Path) -> bytes:
    """A log's content, once a line at the end that a crash cut off is removed."""
    data = read_bytes(path)
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) < len(data):
        os.truncate(path, len(whole))
    return whole


def _numbers_from(first: int, log: bytes, number: str) -> set[int]:
    """The numbers of the last rows of a log, as far back as they are not below the first."""
    found: set[int] = set()
    for line in reversed(log.splitlines()):
        there = json.loads(line).get(number) if is_row(line) else None
        if isinstance(there, int):
            if there < first:
                break
            found.add(there)
    return found


def is_row(line: bytes) -> bool:
    """Whether a line of a log can be read."""
    try:
        return isinstance(json.loads(line), dict)
    except (ValueError, RecursionError):
        return False


def remove(path: Path) -> None:
    """Removes a file, if it is there.

    Raises:
        PlanspaceError: it cannot be removed.
    """
    with _explain_write(path):
        path.unlink(missing_ok=True)


def move(file: Path, to: Path) -> None:
    """Renames a file within its folder.

    Raises:
        PlanspaceError: it cannot be renamed.
    """
    with _explain_write(to):
        os.replace(file, to)
        _sync_folder(file.parent)


# --- one folder -------------------------------------------------------------------------------------


def make_folder(path: Path) -> Path:
    """Makes a folder and those above it, and checks that it can be written.

    Raises:
        PlanspaceError: it cannot be made or written.
    """
    with _explain_write(path):
        missing = [folder for folder in (path, *path.parents) if not folder.exists()]
        path.mkdir(parents=True, exist_ok=True)
        for folder in missing:
            _sync_folder(folder.parent)
        probe = path / f"{TEMPORARY_PREFIX}probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    return path


def open_run(path: Path, config: Mapping[str, Any]) -> Path:
    """Opens a run folder, new or to be continued.

    Args:
        path: the folder.
        config: the resolved settings, plain data; kept as `config.json`.

    Returns:
        The folder.

    Raises:
        PlanspaceError: it cannot be written, holds something else, or was made with other settings
            (each difference is named).
    """
    make_folder(path)
    kept = path / CONFIG
    config = json.loads(json.dumps(config))
    if not kept.exists():
        strangers = [p.name for p in path.iterdir() if not p.name.startswith(TEMPORARY_PREFIX)]
        if strangers:
            raise PlanspaceError(
                f"{path} is not empty and is not a planspace run (it holds {sorted(strangers)[0]!r}); "
                "choose another --out."
            )
        write_json(kept, config)
        return path
    changed = list(differences(read_json(kept), config))
    if changed:
        raise PlanspaceError(
            f"{path} was made with other settings: {'; '.join(changed)}. "
            "Choose another --out, or give the same settings to continue it."
        )
    return path


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps a folder to this process; a crash gives it up, too.

    Raises:
        PlanspaceError: another process keeps it.
    """
    with _explain_write(folder):
        flags = os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0)  # a link's target is not to be made
        descriptor = os.open(folder / f"{TEMPORARY_PREFIX}lock", flags)
    try:
        if fcntl is not None:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise PlanspaceError(
                    f"another command is at work in {folder}; wait for it, or choose another --out."
                ) from error
        yield
    finally:
        os.close(descriptor)


# --- damage ----------------------------------------------------------------------------------------


def damaged(path: Path, what: str) -> PlanspaceError:
    """Builds the error for a file that is not what was written."""
    return PlanspaceError(
        f"{path} was altered or damaged: {what}. Restore it from a copy; or `planspace repair "
        f"{path.parent}` sets it aside, and the command that made it makes it again."
    )


@contextlib.contextmanager
def refusing_nonsense(path: Path) -> Iterator[None]:
    """Turns what a file that makes no sense leads to into an error that names the file.

    Raises:
        PlanspaceError: something in it is missing, or of another kind, size or range than it should be; or
            there is no memory for it.
    """
    try:
        with within_memory(path):
            yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        text = " ".join(str(error).split())[:200]
        raise damaged(path, f"it makes no sense ({type(error).__name__}: {text})") from error


# --- hashes -----------------------------------------------------------------------------------------


def json_hash(value: Mapping[str, Any]) -> str:
    """SHA-256 of plain data, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes.

    Raises:
        PlanspaceError: it is missing or unreadable.
    """
    check_file(path, may_be_link=True)
    with explain_read(path), open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Names each value that is not the same in two trees of plain data."""
    for key in sorted(old.keys() | new.keys()):
        before, now = old.get(key), new.get(key)
        if isinstance(before, dict) and isinstance(now, dict):
            yield from differences(before, now, f"{prefix}{key}.")
        elif before != now:
            yield f"{prefix}{key} was {before!r}, now {now!r}"


@contextlib.contextmanager
def explain_read(path: Path) -> Iterator[None]:
    """Turns what the operating system says of a file that cannot be read into our error.

    Raises:
        PlanspaceError: it cannot be read.
    """
    try:
        with within_memory(path):
            yield
    except OSError as error:
        raise PlanspaceError(f"cannot read {path}: {error.strerror or error}.") from error


@contextlib.contextmanager
def within_memory(path: Path | str) -> Iterator[None]:
    """Turns a lack of memory into an error that names the file it was wanted for.

    Raises:
        PlanspaceError: there is not enough.
    """
    try:
        yield
    except MemoryError as error:
        raise PlanspaceError(f"there is not enough memory to read {path}.") from error


@contextlib.contextmanager
def _explain_write(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise PlanspaceError(
            f"cannot write {path}: {error.strerror}. What was saved before is intact; "
            "make room or choose another --out, and run the same command again."
        ) from error


def _sync_folder(path: Path) -> None:
    if os.name == "nt":  # Windows cannot open a folder to flush it
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
