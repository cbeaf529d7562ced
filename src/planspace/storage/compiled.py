"""A cache of the programs that XLA compiled: without it, most of a start goes into compiling."""

import hashlib
import os
import platform
import time
import warnings
from pathlib import Path

import jax

from planspace.workers import CPU_INFO, count_cores

MAX_AGE_S = 30 * 24 * 3600
"""Older programs are removed. A program that is still in use is then compiled once more."""
MIN_COMPILE_S = 0.2
"""Programs that compile faster are not cached."""
_CPU_LINES = ("vendor_id", "cpu family", "model", "flags", "CPU implementer", "CPU part", "Features")


def use_compilation_cache() -> None:
    """Make JAX store the programs that it compiles from now on, and load stored ones.

    They are stored in the user's cache folder, separately for each type of CPU and number of threads, because
    a program is compiled for these and machines may share a home folder. If the user has set JAX's own cache
    or turned it off (`JAX_ENABLE_COMPILATION_CACHE=false`), nothing changes. Call this before anything is
    compiled.

    Cached programs are executed without a check. Therefore a folder that others can write is not used, and
    programs are never stored in a run folder, which may be passed on.
    """
    if jax.config.jax_compilation_cache_dir is not None or os.name == "nt":
        return
    try:
        folder = _make_cache_folder()
    except (OSError, RuntimeError):  # no home folder, or it is not writable
        return
    if folder is None:
        return
    # JAX warns of a program that a crash truncated, which it compiles again, and of a full disk
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache entry")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_S)


def _make_cache_folder() -> Path | None:
    """Make this machine's cache folder and remove old programs; None if others can write the folder."""
    if not hasattr(os, "getuid"):  # Windows, where the mode of a folder does not say who can write it
        return None
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "planspace" / _machine_hash()
    base.mkdir(parents=True, exist_ok=True)
    for part in (folder.parent, folder):
        part.mkdir(mode=0o700, exist_ok=True)
        status = part.lstat()
        if status.st_uid != os.getuid() or status.st_mode & 0o022:
            return None
    for file in folder.iterdir():
        if file.stat().st_mtime < time.time() - MAX_AGE_S:
            file.unlink(missing_ok=True)
    return folder


def _machine_hash() -> str:
    """Hash of what a compiled program depends on besides JAX's version and flags, which JAX checks."""
    lines = CPU_INFO.read_text().splitlines() if CPU_INFO.exists() else [platform.node()]
    cpu = {line for line in lines if line.startswith(_CPU_LINES)} or {*lines}
    parts = [platform.machine(), *sorted(cpu), str(count_cores()), os.environ.get("NPROC", "")]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
