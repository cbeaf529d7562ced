"""What XLA compiled is kept for the next start, most of which goes into compiling otherwise."""

import hashlib
import os
import platform
import time
import warnings
from pathlib import Path

import jax

from planspace.workers import CPU_INFO, count_cores

KEPT_S = 30 * 24 * 3600
"""Older programs are removed; what is in use still is compiled once more."""
MIN_COMPILE_S = 0.2
"""What compiles faster is not worth a file."""
_CPU_LINES = ("vendor_id", "cpu family", "model", "flags", "CPU implementer", "CPU part", "Features")


def keep_compiled() -> None:
    """Has JAX keep what it compiles from now on, and take what it has kept.

    It is kept in the user's cache folder, apart for each kind of CPU and number of threads, for which a
    program is made: machines may share a home folder. A user who has set JAX's own cache, or turned it off
    (`JAX_ENABLE_COMPILATION_CACHE=false`), is left alone. Call it before anything is compiled.

    Programs are executed as they are. So nothing is taken from a folder that others could write, and none is
    kept in a run's, which may be passed on.
    """
    if jax.config.jax_compilation_cache_dir is not None or os.name == "nt":
        return
    try:
        folder = _make_folder()
    except (OSError, RuntimeError):  # no home, or none that can be written
        return
    if folder is None:
        return
    # a program that a crash cut off is compiled again, and one that the disk has no room for is not kept
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache entry")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_S)


def _make_folder() -> Path | None:
    """The folder for this machine's programs, without old ones; None if others could write there."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "planspace" / _machine()
    base.mkdir(parents=True, exist_ok=True)
    for part in (folder.parent, folder):
        part.mkdir(mode=0o700, exist_ok=True)
        status = part.lstat()
        if status.st_uid != os.getuid() or status.st_mode & 0o022:
            return None
    for file in folder.iterdir():
        if file.stat().st_mtime < time.time() - KEPT_S:
            file.unlink(missing_ok=True)
    return folder


def _machine() -> str:
    """What a program depends on apart from JAX's version, its flags and itself, which JAX looks at."""
    lines = CPU_INFO.read_text().splitlines() if CPU_INFO.exists() else [platform.node()]
    cpu = {line for line in lines if line.startswith(_CPU_LINES)} or {*lines}
    parts = [platform.machine(), *sorted(cpu), str(count_cores()), os.environ.get("NPROC", "")]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
