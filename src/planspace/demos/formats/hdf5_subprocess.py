"""Untrusted HDF5 files: read in a subprocess with limits on memory and time.

If HDF5's reader or MuJoCo crashes, hangs or runs out of memory, this process raises an error. The subprocess
leaves a dataset folder, which is safe to read.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from planspace.demos.episode import Episode
from planspace.demos.folder import DemoFolder
from planspace.demos.recording import Imported, ImportOptions, source_name
from planspace.demos.state_info import StateInfo, parse_info
from planspace.demos.stored import StoredDemos
from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.subprocess_model import MEMORY_BYTES, limit_resources

CPU_S, WALL_S = 600, 1200


def read_in_subprocess(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Call `read_hdf5` in a subprocess.

    Args:
        sources: at least one file.
        info: the states of the planning problem; None if there is no problem.
        options: how to read the files.

    Raises:
        UsageError: an option does not fit the files.
        PlanspaceError: the files cannot be read, or not within the limits.
    """
    staging = tempfile.TemporaryDirectory(prefix="planspace-")
    try:
        request = {
            "sources": [os.path.abspath(source) for source in sources],
            "info": info.plain_with_files() if info else None,
            "options": asdict(replace(options, untrusted=False)),
            "out": staging.name,
        }
        answer = _run_subprocess(request, source_name(sources))
        stored = StoredDemos(staging.name)
    except BaseException:
        staging.cleanup()
        raise
    return Imported(stored.info, _episodes(stored, staging), tuple(answer["notices"]))


def _episodes(stored: StoredDemos, staging: tempfile.TemporaryDirectory) -> Iterator[Episode]:
    with staging:
        yield from stored.episodes()


def _run_subprocess(request: dict[str, object], where: str) -> dict[str, Any]:
    try:
        done = subprocess.run(
            [sys.executable, "-m", "planspace.demos.formats.hdf5_subprocess"],
            input=json.dumps(request).encode(),
            capture_output=True,
            timeout=WALL_S,
            check=False,
        )
        answer = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError):
        raise PlanspaceError(
            f"{where} cannot be read within {CPU_S} s of CPU time and {MEMORY_BYTES >> 30} GiB of memory, or "
            "crashes the reader of HDF5."
        ) from None
    if "error" in answer:
        raise (UsageError if answer["usage"] else PlanspaceError)(answer["error"])
    return answer


def _main() -> None:
    """Read one request from standard input and write one answer to standard output."""
    request = json.load(sys.stdin)
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print goes to standard error
    limit_resources(MEMORY_BYTES, CPU_S)
    from planspace.demos.formats.hdf5 import read_hdf5

    try:
        info = parse_info(request["info"]) if request["info"] else None
        imported = read_hdf5(request["sources"], info, ImportOptions(**request["options"]))
        DemoFolder(Path(request["out"]), imported.info, {}).extend(imported.episodes)
        answer = {"notices": imported.notices}
    except PlanspaceError as error:
        answer = {"error": str(error), "usage": isinstance(error, UsageError)}
    json.dump(answer, out)
    out.flush()


if __name__ == "__main__":
    _main()
