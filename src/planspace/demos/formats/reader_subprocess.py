"""Untrusted sources: read in a subprocess with limits on memory and time.

If the reader of HDF5 or Parquet, or MuJoCo, crashes, hangs or runs out of memory, this process raises an
error. The subprocess leaves a dataset folder, which is safe to read.
"""

import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from planspace.demos.episode import Episode
from planspace.demos.folder import DemoFolder
from planspace.demos.recording import Imported, ImportOptions, Use, source_name
from planspace.demos.state_info import StateInfo, parse_info
from planspace.demos.stored import StoredDemos
from planspace.mjcf.subprocess_model import MEMORY_BYTES
from planspace.storage.limited import ask, serve

CPU_S, WALL_S = 600, 1200


def read_in_subprocess(
    name: str, sources: Sequence[str], info: StateInfo | None, options: ImportOptions
) -> Imported:
    """Call the reader of a format in a subprocess.

    Args:
        name: the key of the format in `FORMATS`.
        sources: at least one file or folder.
        info: the states of the planning problem; None if there is no problem.
        options: how to read the sources.

    Raises:
        UsageError: an option does not fit the sources.
        PlanspaceError: the sources cannot be read, or not within the limits.
    """
    staging = tempfile.TemporaryDirectory(prefix="planspace-")
    try:
        request = {
            "format": name,
            "sources": [os.path.abspath(source) for source in sources],
            "info": info.plain_with_files() if info else None,
            "options": asdict(replace(options, untrusted=False)),
            "out": staging.name,
        }
        failure = (
            f"{source_name(sources)} cannot be read within {CPU_S} s of CPU time and "
            f"{MEMORY_BYTES >> 30} GiB of memory, or crashes the reader of its format."
        )
        limits = {"memory_bytes": MEMORY_BYTES, "cpu_s": CPU_S, "wall_s": WALL_S}
        answer = ask("planspace.demos.formats.reader_subprocess", request, **limits, failure=failure)
        stored = StoredDemos(staging.name)
    except BaseException:
        staging.cleanup()
        raise
    return Imported(
        stored.info,
        _episodes(stored, staging),
        tuple(answer["notices"]),
        exported=answer["exported"],
        uses=tuple(Use(**use) for use in answer["uses"]),
        splits=answer["splits"],
    )


def _episodes(stored: StoredDemos, staging: tempfile.TemporaryDirectory) -> Iterator[Episode]:
    with staging:
        yield from stored.episodes()


def _work(request: dict[str, Any]) -> dict[str, Any]:
    """Read the sources of one request into a dataset folder."""
    from planspace.demos.formats.registry import FORMATS
    from planspace.demos.tables import import_tables

    info = parse_info(request["info"]) if request["info"] else None
    options = ImportOptions(**request["options"])
    found = FORMATS[request["format"]].read(request["sources"], info, options)
    imported = found if isinstance(found, Imported) else import_tables(found, info, options)
    DemoFolder(Path(request["out"]), imported.info, {}).extend(imported.episodes)
    return {
        "notices": imported.notices,
        "exported": imported.exported,
        "uses": [asdict(use) for use in imported.uses],
        "splits": {name: list(numbers) for name, numbers in imported.splits.items()},
    }


if __name__ == "__main__":
    serve(_work)
