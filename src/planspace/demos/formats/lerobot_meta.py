"""The folder `meta` of a LeRobot dataset: what the columns mean, and which file has which episode.

    v2.0, v2.1   meta/episodes.jsonl                        data/chunk-000/episode_000000.parquet, ...
    v3.0         meta/episodes/chunk-000/file-000.parquet   data/chunk-000/file-000.parquet, ...

In v3.0 one file of `data` has many episodes. `meta/info.json` has the template of the paths in `data`, the
frames per second, and for each feature its type, its shape and the names of its numbers. All numbers are in
`data`; videos and images are not read.
"""

import json
import os
import re
import string
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from planspace.demos.formats.parquet_file import open_parquet, read_column
from planspace.errors import PlanspaceError, quoted
from planspace.storage.checks import MAX_JSON_BYTES
from planspace.storage.files import read_bytes
from planspace.storage.json_files import read_json

INFO, EPISODE_LINES, EPISODE_FILES = "meta/info.json", "meta/episodes.jsonl", "meta/episodes"
VERSIONS = ("v2.0", "v2.1", "v3.0")
TIME, FRAME, EPISODE = "timestamp", "frame_index", "episode_index"
INDEX_FEATURES = (TIME, FRAME, EPISODE, "index", "task_index")
"""Features that every dataset has and that are not states."""
NUMBER = re.compile(r"(u?int|float)\d{1,3}|bool")
"""Types of features that are numbers."""
MAX_SIZE = 10_000
"""Most numbers of a feature; no robot has this many joints."""


@dataclass(frozen=True)
class Feature:
    """A feature: a column, or a video."""

    dtype: str
    """Type of its numbers, or `video`, `image` or `string`."""
    size: int | None
    """How many numbers it has per frame; None if it is not a number or a vector of numbers."""
    names: tuple[str, ...] = ()
    """Names of its numbers; empty if they have none."""

    @property
    def kind(self) -> str:
        """What it is, for messages."""
        return self.dtype if self.size is None else f"{self.size} numbers"


@dataclass(frozen=True)
class DataFile:
    """A file of `data`."""

    path: Path
    lengths: dict[int, int]
    """Number of frames of each of its episodes, by their numbers."""


@dataclass(frozen=True)
class LeRobotMeta:
    """The content of `meta`."""

    root: Path
    """The dataset folder."""
    fps: float | None
    """Frames per second; None if it is unknown."""
    features: dict[str, Feature]
    """The features by key."""
    splits: dict[str, range]
    """The numbers of the episodes in each split."""
    files: tuple[DataFile, ...]
    """The files of `data` in the order of their first episodes."""


def read_meta(root: Path) -> LeRobotMeta:
    """Read and check `meta`.

    Args:
        root: the dataset folder.

    Raises:
        PlanspaceError: a file is missing or damaged, or the dataset has another version; the message names
            the file and the key.
    """
    file = inside(root, INFO)
    info = read_json(file)
    version = info.get("codebase_version")
    if version not in VERSIONS:
        raise PlanspaceError(
            f"{file}: 'codebase_version' is {quoted(version)}; planspace reads {', '.join(VERSIONS)}. "
            "Convert the dataset with the scripts of the package lerobot."
        )
    template, fps = info.get("data_path"), info.get("fps")
    if not isinstance(template, str):
        raise _wrong(file, "data_path", template, "a template of paths")
    if not (fps is None or (isinstance(fps, int | float) and 0 < fps < float("inf"))):
        raise _wrong(file, "fps", fps, "a positive number of frames per second")
    files = _files_3(root, template) if version == "v3.0" else _files_2(root, template, info, file)
    fps = None if fps is None else float(fps)
    return LeRobotMeta(root, fps, _features(info, file), _splits(info, file), files)


def inside(root: Path, relative: str) -> Path:
    """A file of the dataset, after a check that it lies in the dataset folder.

    Args:
        root: the dataset folder; it may be a link.
        relative: path within it.

    Raises:
        PlanspaceError: the path leads out of the folder, also by links.
    """
    parts = PurePosixPath(relative).parts
    if not parts or relative.startswith("/") or ".." in parts or "\\" in relative or "\0" in relative:
        raise PlanspaceError(f"{root}: {quoted(relative)} is not a path within the dataset folder.")
    path = root / relative
    target = os.path.realpath(path)
    if not Path(target).is_relative_to(os.path.realpath(root)):
        raise PlanspaceError(
            f"{path} is a link out of its folder, to {target}; copy the dataset with `cp -rL` and import the "
            "copy."
        )
    return path


# --- features ---------------------------------------------------------------------------------------


def _features(info: dict[str, Any], file: Path) -> dict[str, Feature]:
    found = info.get("features")
    if not isinstance(found, dict) or not found:
        raise _wrong(file, "features", found, "an object with the features")
    return {key: _feature(value, f"features/{key}", file) for key, value in found.items()}


def _feature(found: Any, key: str, file: Path) -> Feature:
    dtype, shape = (found.get("dtype"), found.get("shape")) if isinstance(found, dict) else (None, None)
    if not isinstance(dtype, str) or not isinstance(shape, list):
        raise _wrong(file, key, found, "an object with 'dtype' and 'shape'")
    if not NUMBER.fullmatch(dtype) or len(shape) > 1:
        return Feature(dtype if not NUMBER.fullmatch(dtype) else f"an array of shape {shape}", None)
    size = shape[0] if shape else 1
    if type(size) is not int or not 0 <= size <= MAX_SIZE:
        raise _wrong(file, f"{key}/shape", shape, f"a number of columns up to {MAX_SIZE}")
    names = tuple(_names(found.get("names")))
    fits = len(names) == len(set(names)) == size and all(name.strip() for name in names)
    return Feature(dtype, size, names if fits else ())


def _names(found: Any) -> list[str]:
    """The names of a feature's numbers: a list, lists by group, or positions by name."""
    if isinstance(found, list) and all(isinstance(name, str) for name in found):
        return found
    if isinstance(found, list):  # lists in a list
        return [name for part in found for name in _names(part)]
    if not isinstance(found, dict):
        return []
    if all(type(position) is int for position in found.values()):
        return sorted(found, key=lambda name: found[name])
    return [name for part in found.values() for name in _names(part)]


def _splits(info: dict[str, Any], file: Path) -> dict[str, range]:
    found = info.get("splits") or {}
    if not isinstance(found, dict):
        raise _wrong(file, "splits", found, "an object with ranges such as '0:50'")
    splits = {}
    for name, text in found.items():
        match = re.fullmatch(r"(\d{1,9}):(\d{1,9})", text) if isinstance(text, str) else None
        if match is None:
            raise _wrong(file, f"splits/{name}", text, "a range such as '0:50'")
        splits[name] = range(int(match[1]), int(match[2]))
    return splits


# --- episodes ---------------------------------------------------------------------------------------


def _files_2(root: Path, template: str, info: dict[str, Any], file: Path) -> tuple[DataFile, ...]:
    """The files of v2.0 and v2.1, one an episode."""
    chunk_size, total = info.get("chunks_size", 1000), info.get("total_episodes", 0)
    if type(chunk_size) is not int or chunk_size < 1:
        raise _wrong(file, "chunks_size", chunk_size, "a positive number of episodes")
    if type(total) is not int:
        raise _wrong(file, "total_episodes", total, "a number of episodes")
    files = {}
    for number, length in _episode_lines(inside(root, EPISODE_LINES)):
        if number in files:
            raise PlanspaceError(f"{root / EPISODE_LINES} has two lines for episode {number}.")
        numbers = {"episode_chunk": number // chunk_size, "episode_index": number, "total_episodes": total}
        files[number] = DataFile(inside(root, _fill(template, numbers, file)), {number: length})
    return tuple(files[number] for number in sorted(files))


def _episode_lines(file: Path) -> Iterator[tuple[int, int]]:
    """The number and the length of each episode in a file of JSON lines."""
    for i, line in enumerate(read_bytes(file, most=MAX_JSON_BYTES).splitlines()):
        if not line.strip():
            continue
        try:
            found = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise PlanspaceError(f"{file}, line {i + 1} is not valid JSON ({error}).") from error
        known = found if isinstance(found, dict) else {}
        number, length = known.get(EPISODE), known.get("length")
        if not (type(number) is int and type(length) is int and min(number, length) >= 0):
            raise PlanspaceError(
                f"{file}, line {i + 1} must have the numbers {EPISODE!r} and 'length', got {quoted(found)}."
            )
        yield number, length


def _files_3(root: Path, template: str) -> tuple[DataFile, ...]:
    """The files of v3.0, each with many episodes."""
    folder = inside(root, EPISODE_FILES)
    paths = sorted(str(path.relative_to(root)) for path in folder.glob("*/*.parquet"))
    if not paths:
        raise PlanspaceError(f"{folder} has no file chunk-000/file-000.parquet; a v3.0 dataset needs it.")
    columns = (EPISODE, "length", "data/chunk_index", "data/file_index")
    rows: list[tuple[int, ...]] = []
    for path in (inside(root, path) for path in paths):
        with open_parquet(path) as opened:
            rows += zip(*(read_column(opened, name, path) for name in columns), strict=True)
    found: dict[tuple[int, int], dict[int, int]] = {}
    for number, length, chunk, index in sorted(rows):
        if min(number, length, chunk, index) < 0:
            raise PlanspaceError(f"{folder}: episode {number} has a negative length or file number.")
        found.setdefault((chunk, index), {})[number] = length
    if len({row[0] for row in rows}) < len(rows):
        raise PlanspaceError(f"{folder} has two rows for one episode.")
    info = root / INFO
    return tuple(
        DataFile(inside(root, _fill(template, {"chunk_index": chunk, "file_index": index}, info)), lengths)
        for (chunk, index), lengths in found.items()
    )


def _fill(template: str, numbers: dict[str, int], file: Path) -> str:
    """Fill numbers into a template such as `data/chunk-{episode_chunk:03d}/...`.

    `str.format` would let the file read attributes of objects and make texts of any length.
    """
    filled = ""
    try:
        parts = list(string.Formatter().parse(template))
    except ValueError:
        parts = [("", "?", "", None)]
    for literal, name, width, conversion in parts:
        filled += literal
        if name is None:
            continue
        if name not in numbers or not re.fullmatch(r"(0\d)?d?", width or "") or conversion:
            fields = ", ".join(f"{{{known}:03d}}" for known in numbers)
            raise _wrong(file, "data_path", template, f"a template with {fields}")
        filled += format(numbers[name], width or "d")
    return filled


def _wrong(file: Path, key: str, found: Any, wanted: str) -> PlanspaceError:
    return PlanspaceError(f"{file}: {key!r} must be {wanted}, got {quoted(found)}.")
