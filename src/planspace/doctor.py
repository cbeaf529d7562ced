"""`planspace doctor`: what is installed, what is missing, and what to do about it."""

import importlib.metadata
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

from planspace.cores import count_cores

PACKAGES = ("planspace", "mujoco", "jax", "equinox", "optax", "gymnasium", "numpy", "scipy", "safetensors")

EXTRAS: dict[str, tuple[tuple[str, ...], str]] = {
    "ompl": (("ompl",), "OMPL's planners beside ours"),
    "minari": (("minari",), "demonstrations from and to Minari"),
    "sb3": (("stable_baselines3", "sb3_contrib"), "Stable-Baselines3 agents"),
    "ray": (("ray",), "studies on a cluster"),
    "onnx": (("onnx", "onnxruntime"), "embeddings as ONNX files"),
    "video": (("imageio_ffmpeg",), "MP4 videos"),
    "track": (("tensorboard", "wandb"), "TensorBoard and Weights & Biases"),
    "docs": (("sphinx", "myst_parser", "furo"), "building the documentation"),
    "fuzz": (("atheris",), "fuzzing"),
    "test": (("pytest", "hypothesis", "beartype"), "running the tests"),
    "dev": (("ruff", "pyright", "codespell_lib"), "linting and type checks"),
}
"""Extra to the modules it brings and what it is for. This version itself uses all but `fuzz`."""

RENDER_PROBE = (
    'import mujoco; m = mujoco.MjModel.from_xml_string(\'<mujoco><worldbody><geom size="1"/></worldbody>'
    "</mujoco>'); r = mujoco.Renderer(m, 16, 16); r.update_scene(mujoco.MjData(m)); r.render()"
)


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    name: str
    value: str
    ok: bool
    advice: str = ""


def examine() -> list[Finding]:
    """Looks at the machine; takes a second or two."""
    findings = [
        Finding("python", platform.python_version(), sys.version_info >= (3, 11), "planspace needs 3.11."),
        Finding("cores", str(count_cores()), True),
    ]
    findings += [Finding(name, importlib.metadata.version(name), True) for name in PACKAGES]
    findings += [_batch(), _rendering()]
    findings += [_extra(name) for name in EXTRAS]
    return findings


def as_text(findings: list[Finding]) -> str:
    """The findings for a terminal."""
    lines = []
    for f in findings:
        advice = f"  -> {f.advice}" if f.advice and not f.ok else ""
        lines.append(f"{'ok ' if f.ok else '-- '} {f.name:<16}{f.value}{advice}")
    return "\n".join(lines)


def as_data(findings: list[Finding]) -> dict[str, Any]:
    """The findings for a program."""
    return {f.name: {"value": f.value, "ok": f.ok, "advice": "" if f.ok else f.advice} for f in findings}


def _batch() -> Finding:
    found = importlib.util.find_spec("mujoco.batch") is not None
    value = "found" if found else "missing"
    return Finding("mujoco.batch", value, found, "pip install 'mujoco>=3.17,!=4.0.0'")


def rendering_backend() -> str | None:
    """The first OpenGL backend MuJoCo can draw with here, named as in MUJOCO_GL, or None.

    Each is tried in a process of its own: a bad GL driver may abort it.
    """
    for backend in _backends():
        environment = {**os.environ, "MUJOCO_GL": backend}
        command = [sys.executable, "-c", RENDER_PROBE]
        try:
            done = subprocess.run(command, env=environment, capture_output=True, timeout=60, check=False)
        except subprocess.TimeoutExpired:
            continue
        if done.returncode == 0:
            return backend
    return None


def rendering_advice() -> str:
    """What to do where no backend works."""
    manager = "apt-get install libosmesa6" if shutil.which("apt-get") else "install OSMesa or an EGL driver"
    chosen = os.environ.get("MUJOCO_GL")
    first = "" if chosen is None else f"unset MUJOCO_GL, which asks for {chosen!r}; else "
    return f"{first}{manager}, set MUJOCO_GL=osmesa"


def _backends() -> list[str]:
    if "MUJOCO_GL" in os.environ:
        return [os.environ["MUJOCO_GL"]]
    if sys.platform != "linux":
        return ["cgl", "glfw"] if sys.platform == "darwin" else ["glfw"]
    return ["glfw", "egl", "osmesa"] if os.environ.get("DISPLAY") else ["egl", "osmesa"]


def _rendering() -> Finding:
    backend = rendering_backend()
    advice = f"only pictures of the robot need it: {rendering_advice()}"
    value = "none" if backend is None else f"works (MUJOCO_GL={backend})"
    return Finding("rendering", value, backend is not None, advice)


def _extra(name: str) -> Finding:
    modules, purpose = EXTRAS[name]
    missing = [m for m in modules if importlib.util.find_spec(m) is None]
    value = f"{'missing' if missing else 'found'} ({purpose})"
    return Finding(f"[{name}]", value, not missing, f"pip install 'planspace[{name}]'")
