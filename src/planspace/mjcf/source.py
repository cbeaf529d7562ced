"""What makes a model again, bit for bit: its files as the user wrote them, and the joints that are held.

A compiled model depends on MuJoCo's version, and MuJoCo's XML writer cuts numbers to six digits. So datasets
and problems keep the files themselves.
"""

import hashlib
import posixpath
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from planspace.errors import PlanspaceError
from planspace.storage.files import make_folder, write_or_link
from planspace.storage.json_files import json_hash

MAIN = "model.xml"
"""Name of the main file of a model that was given as text."""
MAX_FILES = 2_000
"""Largest number of files in a model."""
_NAME = re.compile(r"[^\x00-\x1f\\:]{1,500}")

Hold = Literal["all"] | Sequence[str] | Mapping[str, Sequence[float]]
"""Which joints are to be held: all that are not planned for, some of them, or some with their positions."""
Held = tuple[tuple[str, tuple[float, ...]], ...]
"""Joints that are held, and their positions."""


@dataclass(frozen=True)
class ModelFile:
    """A model file to read, and the joints that move and that are held."""

    path: Path
    """The MJCF file."""
    joints: Sequence[str] | None = None
    """Names of the joints that move; None moves all. The others are held: slides, hinges and balls without a
    word, a free joint only if `hold` names it."""
    root: Path | None = None
    """The folder that holds every file of the model; by default that of the MJCF file."""
    hold: Hold = ()
    """Joints that are held, with or without their positions."""
    keyframe: str = ""
    """Keyframe of the model that gives the positions of held joints; by default the reference pose."""


@dataclass(frozen=True, repr=False)
class ModelSource:
    """The files that a model is compiled from, and the joints that are held in it."""

    text: str
    """The MJCF text of the main file."""
    main: str = MAIN
    """Path of the main file below the root folder, with `/`."""
    files: tuple[tuple[str, bytes], ...] = ()
    """Path below the root folder and content of every other file that the model refers to."""
    held: Held = ()
    """Joints that are taken out of the model, and their positions in it [m, rad, or a quaternion]."""

    def __repr__(self) -> str:
        """Return the names of the files and of the held joints."""
        held = f", held {', '.join(name for name, _ in self.held)}" if self.held else ""
        return f"ModelSource({self.main}, {1 + len(self.files)} files{held})"

    @property
    def is_text(self) -> bool:
        """Whether the main file's text alone makes the model."""
        return not self.files and not self.held

    @property
    def contents(self) -> dict[str, bytes]:
        """Path and content of every file."""
        return {self.main: self.text.encode(), **dict(self.files)}

    @property
    def hash(self) -> str:
        """SHA-256 of everything that makes the model."""
        return json_hash(self.plain())

    def plain(self) -> dict[str, Any]:
        """Describe the model as plain data, in which the SHA-256 of each file stands for its content."""
        return {
            "main": self.main,
            "files": dict(self._digests),
            "held": {name: list(position) for name, position in self.held},
        }

    @cached_property
    def _digests(self) -> dict[str, str]:
        """The SHA-256 of each file."""
        return {name: hashlib.sha256(data).hexdigest() for name, data in self.contents.items()}

    def write(self, folder: Path, same: Sequence[Path] = ()) -> None:
        """Write the files below a folder; a file that is there already stays.

        Args:
            folder: the folder.
            same: folders that may hold the same files; see `write_or_link`.

        Raises:
            PlanspaceError: a file cannot be written.
        """
        for name, data in self.contents.items():
            path = folder / name
            if not path.is_file() or path.read_bytes() != data:
                make_folder(path.parent)
                write_or_link(path, data, (other / name for other in same))


def as_source(given: "ModelSource | str") -> ModelSource:
    """Return a model given as MJCF text as a source."""
    return ModelSource(given) if isinstance(given, str) else given


def model_key(source: ModelSource) -> dict[str, Any]:
    """Describe a model in saved settings: `mjcf` has a model of one file, `model` describes any other."""
    return {"mjcf": source.text} if source.is_text else {"mjcf": "", "model": source.plain()}


def is_inside(path: str) -> bool:
    """Whether a path below the root folder of a model stays below it."""
    return bool(_NAME.fullmatch(path)) and path[0] != "/" and posixpath.normpath(path).split("/")[0] != ".."


def outside(name: str, where: str) -> PlanspaceError:
    """Build the error for a file outside the root folder of a model, to be raised by the caller."""
    return PlanspaceError(
        f"{where} refers to {name[:80]!r}, outside the folder of the problem file. Move the problem file to "
        "a folder above all files of the model."
    )


def parse_plain(found: Mapping[str, Any]) -> tuple[str, dict[str, str], Held]:
    """Read what `ModelSource.plain` describes: main file, SHA-256 of each file, and held joints.

    Raises:
        KeyError: a part is missing.
        TypeError: a part has the wrong type.
        ValueError: a path leads out of the folder, or the main file is missing.
    """
    main, files, held = found["main"], found["files"], found["held"]
    if not isinstance(files, dict) or not isinstance(held, dict) or not 0 < len(files) <= MAX_FILES:
        raise TypeError("the files or the held joints of its model have the wrong type")
    for name, digest in files.items():
        if not isinstance(digest, str) or not is_inside(name) or posixpath.normpath(name) != name:
            raise ValueError(f"its model has the invalid file {name[:80]!r}")
    if main not in files:
        raise ValueError("the main file of its model is missing")
    return main, files, tuple((name, tuple(map(float, position))) for name, position in held.items())
