"""An audit hook that watches what Python opens, moves, removes, imports, runs and connects to."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from planspace.errors import PlanspaceError
from planspace.storage.files import file_hash
from planspace.storage.json_files import read_sealed, write_sealed

Read = Callable[[], Any]
Change = Callable[[dict[str, Any]], object]
"""Function that modifies a description or a dict of arrays in place."""

FILES = {"open": 1, "os.remove": 1, "os.rename": 2, "os.truncate": 1, "os.mkdir": 1, "os.rmdir": 1}
"""Audit events about files, and how many of their arguments are paths."""
PROGRAMS = ("os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "subprocess.Popen")
CANARY = "planspace_canary"
"""A module that is only imported if a hostile file manages to have it imported."""
PYTHON_FOLDERS = [os.path.realpath(path) for path in (sys.prefix, sys.base_prefix, *sys.path) if path]
seen: list[tuple[str, Any]] | None = None


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    watched = event in FILES or event in PROGRAMS or event.startswith("socket.")
    if seen is not None and (watched or (event == "import" and arguments[0].startswith(CANARY))):
        seen.append((event, arguments))


sys.addaudithook(_hook)


@contextlib.contextmanager
def nothing_else_happens(folder: Path) -> Iterator[None]:
    """Assert that the block runs no program, opens no socket, and touches only files in `folder` and
    Python's own."""
    global seen
    seen = []
    try:
        yield
    finally:
        events, seen = seen, None
    allowed = [os.path.realpath(folder), *PYTHON_FOLDERS]
    for event, arguments in events:
        assert event in FILES, (event, arguments)
        for path in arguments[: FILES[event]]:
            if not isinstance(path, int):
                real = Path(os.path.realpath(os.fsdecode(path)))
                assert any(real.is_relative_to(place) for place in allowed), (event, arguments)
    assert CANARY not in sys.modules


def assert_rejected(folder: Path, read: Read, message: str) -> None:
    """Assert that reading fails with one printable line, and that nothing else happens."""
    with nothing_else_happens(folder), pytest.raises(PlanspaceError, match=message) as caught:
        read()
    assert str(caught.value).isprintable() and len(str(caught.value)) < 2000


def reseal(file: Path, change: Change) -> None:
    """Change a description and recompute its checksum and the hash of its weights, as an attacker can."""
    content = read_sealed(file)
    weights = file.with_suffix(".safetensors")
    if "weights_sha256" in content:
        content["weights_sha256"] = file_hash(weights)
    change(content)
    write_sealed(file, content)
