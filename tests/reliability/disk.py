"""A disk that fails at a chosen call, and that loses unflushed data when the power fails."""

import builtins
import errno
import io
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import pytest

Fault = Literal["raise", "exit", "ENOSPC", "EIO", "short", "power", "power after renames"]

FAULTS: tuple[Fault, ...] = ("raise", "exit", "ENOSPC", "EIO", "short", "power", "power after renames")
"""What goes wrong at the chosen call.

- raise: an interrupt.
- exit: the process ends; half of a write is done.
- ENOSPC, EIO: the call fails with this error.
- short: a write is incomplete; any other call reports a full disk.
- power: what was not flushed is lost, names included.
- power after renames: names are kept, unflushed contents are lost.
"""


class Interrupted(BaseException):
    """An exception that the code does not expect."""


class Dead(BaseException):
    """The process has ended; nothing that it does now reaches the disk."""


class FaultyDisk:
    """Counts the calls that change a folder, and makes one of them fail.

    These calls are: opening for writing, writing, flushing, renaming, removing, truncating, and making a
    folder that does not exist. `calls` is their number.
    """

    def __init__(self, root: Path, fault: Fault | None = None, at: int = 0):
        """Watch a folder.

        Args:
            root: the folder; calls outside of it are neither counted nor changed.
            fault: what goes wrong; None only counts.
            at: number of the call at which it goes wrong, counted from 1.
        """
        self.calls = 0
        self._root, self._fault, self._at, self._dead = root, fault, at, False
        self._patch = pytest.MonkeyPatch()
        self._names: dict[Path, int] = {}
        """Path to the number of the file that has this name now."""
        self._content: dict[int, bytes] = {}
        """Number of a file to its flushed content."""
        self._folders = {root}
        for path in root.rglob("*"):
            if path.is_dir():
                self._folders.add(path)
            else:
                self._content[self._number(path)] = path.read_bytes()
        self._kept_names, self._kept_folders = dict(self._names), set(self._folders)

    def __enter__(self) -> "FaultyDisk":
        self._open, self._os_open = io.open, os.open
        for module in (builtins, io):
            self._patch.setattr(module, "open", self._opened)
        self._patch.setattr(os, "open", self._os_opened)
        for name in ("replace", "rename", "unlink", "mkdir", "truncate"):
            self._patch.setattr(os, name, self._patched_path_call(name, getattr(os, name)))
        self._patch.setattr(os, "fsync", self._patched_flush(os.fsync))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> None:
        self._patch.undo()
        if self._dead and self._fault in ("power", "power after renames"):
            self._lose(renamed=self._fault == "power after renames")

    def cut_power(self) -> None:
        """Cut the power now."""
        self._dead = True

    # --- calls ----------------------------------------------------------------------------------------

    def _call(self, path: Path, act: Callable[[], Any], half: Callable[[], Any] | None = None) -> Any:
        if path != self._root and self._root not in path.parents:
            return act()
        if self._dead:
            raise Dead
        self.calls += 1
        if self.calls != self._at or self._fault is None:
            return act()
        if self._fault == "raise":
            raise Interrupted
        if self._fault == "short" and half is not None:
            return half()
        if self._fault in ("ENOSPC", "EIO", "short"):
            number = errno.EIO if self._fault == "EIO" else errno.ENOSPC
            raise OSError(number, os.strerror(number))
        self._dead = True
        if half is not None:
            half()
        raise Dead

    def _opened(self, file: Any, mode: str = "r", *args: Any, **options: Any) -> Any:
        if isinstance(file, int) or not set(mode) & set("wax+"):
            return self._open(file, mode, *args, **options)
        path = Path(file).absolute()

        def act() -> Any:
            opened = self._open(file, mode, *args, **options)
            self._number(path)
            return _Writing(opened, self, path)

        return self._call(path, act)

    def _os_opened(self, file: Any, flags: int, *args: Any, **options: Any) -> int:
        path = Path(os.fsdecode(file)).absolute()
        if not flags & (os.O_CREAT | os.O_WRONLY | os.O_RDWR):
            return self._os_open(file, flags, *args, **options)

        def act() -> int:
            opened = self._os_open(file, flags, *args, **options)
            self._number(path)
            return opened

        return self._call(path, act)

    def write(self, path: Path, file: Any, data: Any) -> int:
        """Write to a file that was opened here, without buffering."""

        def act(part: Any = data) -> int:
            done = file.write(part)
            file.flush()
            return int(done)

        def half() -> int:
            done = act(data[: len(data) // 2])
            if self._fault == "short" and not isinstance(file, io.RawIOBase):  # Python would have retried
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return done

        return self._call(path, act, half)

    def _patched_path_call(self, name: str, do: Callable[..., Any]) -> Callable[..., Any]:
        def call(file: Any, *args: Any, **options: Any) -> None:
            path = Path(os.fsdecode(file)).absolute()
            if name == "mkdir" and path in self._folders:
                do(file, *args, **options)
                return

            def act() -> Any:
                do(file, *args, **options)
                if name in ("replace", "rename"):
                    self._names[Path(args[0]).absolute()] = self._names.pop(path)
                elif name == "unlink":
                    self._names.pop(path, None)
                elif name == "mkdir":
                    self._folders.add(path)

            self._call(path, act)

        return call

    def _patched_flush(self, do: Callable[[int], None]) -> Callable[[int], None]:
        def call(descriptor: int) -> None:
            path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))

            def act() -> None:
                do(descriptor)
                if not path.is_dir():
                    self._content[self._names[path]] = path.read_bytes()
                    return
                for kept, now in ((self._kept_names, self._names), (self._kept_folders, self._folders)):
                    for gone in [x for x in kept if x.parent == path and x not in now]:
                        kept.pop(gone) if isinstance(kept, dict) else kept.remove(gone)
                self._kept_names |= {x: i for x, i in self._names.items() if x.parent == path}
                self._kept_folders |= {x for x in self._folders if x.parent == path}

            self._call(path, act)

        return call

    # --- after a power failure ------------------------------------------------------------------------

    def _number(self, path: Path) -> int:
        return self._names.setdefault(path, max(self._names.values(), default=-1) + 1 + len(self._content))

    def _lose(self, *, renamed: bool) -> None:
        names = self._names if renamed else self._kept_names
        folders = self._folders if renamed else self._kept_folders
        for path in self._root.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        for folder in sorted(folders - {self._root}):
            if folder.parent.exists():
                folder.mkdir()
        for path, number in names.items():
            if path.parent.exists():
                path.write_bytes(self._content.get(number, b""))


class _Writing:
    """An open file whose writes are counted."""

    def __init__(self, file: Any, disk: FaultyDisk, path: Path):
        self._file, self._disk, self._path = file, disk, path

    def write(self, data: Any) -> int:
        return self._disk.write(self._path, self._file, data)

    def __enter__(self) -> "_Writing":
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)
