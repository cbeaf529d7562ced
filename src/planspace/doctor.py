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

PACKAGES = ("planspace", "mujoco", "jax", "equinox", "optax", "gymnasium", "numpy", "scipy", "safetensors")

EXTRAS: dict[str, tuple[tuple[str, ...], str]] = {
    "ompl": (("ompl",), "OMPL's planners beside ours"),
    "minari": (("minari",), "demonstrations from and to Minari"),
    "sb3": (("stable_baselines3", "sb3_contrib"), "Stable-Baselines3 agents"),
    "ray": (("ray",), "studies on a cluster"),
    "onnx": (("onnx", "onnxruntime"), "embeddings as ONNX files"),
    "video": (("imageio_ffmpeg",), "MP4 videos"),
    "track": (("tensorboard", "wandb"), "TensorBoard and Weights & Biases"),
    "docs": (("sphinx", "myst_parser"), "building the documentation"),
    "fuzz": (("atheris",), "fuzzing"),
    "test": (("pytest", "hypothesis", "beartype"), "running the tests"),
    "dev": (("ruff", "pyright", "codespell_lib"), "linting and type checks"),
}
"""Extra to the modules it brings and what it is for. This version itself uses `test` and `dev` alone."""

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
        Finding("cores", str(os.cpu_count()), True),
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


def _rendering() -> Finding:
    """Tries to render in a process of its own: a bad GL driver may abort it."""
    backends = [os.environ["MUJOCO_GL"]] if "MUJOCO_GL" in os.environ else ["egl", "osmesa"]
    if os.environ.get("DISPLAY") and "MUJOCO_GL" not in os.environ:
        backends.insert(0, "glfw")
    for backend in backends:
        environment = {**os.environ, "MUJOCO_GL": backend}
        command = [sys.executable, "-c", RENDER_PROBE]
        try:
            done = subprocess.run(command, env=environment, capture_output=True, timeout=60, check=False)
        except subprocess.TimeoutExpired:
            continue
        if done.returncode == 0:
            return Finding("rendering", f"works (MUJOCO_GL={backend})", True)
    manager = "apt-get install libosmesa6" if shutil.which("apt-get") else "install OSMesa or an EGL driver"
    return Finding(
        "rendering", "none", False, f"only pictures of the robot need it: {manager}, set MUJOCO_GL=osmesa"
    )


def _extra(name: str) -> Finding:
    modules, purpose = EXTRAS[name]
    missing = [m for m in modules if importlib.util.find_spec(m) is None]
    value = f"{'missing' if missing else 'found'} ({purpose})"
    return Finding(f"[{name}]", value, not missing, f"pip install 'planspace[{name}]'")
