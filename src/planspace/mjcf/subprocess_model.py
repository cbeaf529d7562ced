"""Untrusted models: read and compiled in a subprocess with limits on memory and time.

If the subprocess crashes, hangs or runs out of memory, this process raises an error. The subprocess returns
files that compile within the limits.
"""

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planspace.mjcf.source import ModelFile, ModelSource, as_source
from planspace.storage.limited import ask, serve

MEMORY_BYTES = 4 << 30
CPU_S, WALL_S = 60, 120


def read_model_in_subprocess(file: ModelFile) -> ModelSource:
    """Call `read_model` in a subprocess.

    Raises:
        PlanspaceError: the model cannot be read, or does not compile within the limits.
        UsageError: a joint is not in the model.
    """
    request = {
        "path": str(file.path.absolute()),
        "joints": None if file.joints is None else list(file.joints),
        "root": None if file.root is None else str(file.root.absolute()),
        "hold": file.hold if isinstance(file.hold, str | Mapping) else list(file.hold),
        "keyframe": file.keyframe,
    }
    return _decoded(_run_subprocess({"file": request}, str(file.path)))


def check_compiles(source: ModelSource | str) -> None:
    """Check in a subprocess that a model compiles.

    Raises:
        PlanspaceError: the model does not compile within the limits.
    """
    _run_subprocess({"source": _encoded(as_source(source))}, "the model")


def _encoded(source: ModelSource) -> dict[str, Any]:
    files = {name: base64.b64encode(data).decode() for name, data in source.files}
    return {"text": source.text, "main": source.main, "files": files, "held": source.held}


def _decoded(found: dict[str, Any]) -> ModelSource:
    files = tuple((name, base64.b64decode(data)) for name, data in found["files"].items())
    held = tuple((name, tuple(position)) for name, position in found["held"])
    return ModelSource(found["text"], found["main"], files, held)


def _run_subprocess(request: dict[str, object], where: str) -> dict[str, Any]:
    failure = (
        f"{where} does not compile within {CPU_S} s of CPU time and {MEMORY_BYTES >> 30} GiB of memory, or "
        "crashes MuJoCo."
    )
    limits = {"memory_bytes": MEMORY_BYTES, "cpu_s": CPU_S, "wall_s": WALL_S}
    return ask("planspace.mjcf.subprocess_model", request, **limits, failure=failure)["source"]


def _work(request: dict[str, Any]) -> dict[str, Any]:
    """Read or compile the model of one request."""
    from planspace.mjcf.compile import load_model
    from planspace.mjcf.read import read_model

    if "file" in request:
        paths = {key: request["file"][key] and Path(request["file"][key]) for key in ("path", "root")}
        return {"source": _encoded(read_model(ModelFile(**request["file"] | paths)))}
    source = _decoded(request["source"])
    load_model(source)
    return {"source": _encoded(source)}


if __name__ == "__main__":
    serve(_work)
