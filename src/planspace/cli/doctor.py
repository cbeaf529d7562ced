"""`planspace doctor`: what is installed, what is missing, and what to do about it."""

import importlib.metadata
import importlib.util
import json
import platform
import sys
from dataclasses import dataclass
from typing import Any

from planspace.physics.rendering import rendering_advice, rendering_backend
from planspace.workers import count_cores

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


@dataclass(frozen=True)
class Doctor:
    """Say what is installed, what is missing, and what to do about it."""

    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Prints the findings."""
        findings = examine()
        print(json.dumps(as_data(findings), indent=2) if self.json else as_text(findings))
