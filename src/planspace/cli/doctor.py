"""`planspace doctor`: what is installed, what is missing, and how to install it."""

import importlib.metadata
import importlib.util
import platform
import re
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from planspace.cli.tables import print_json
from planspace.physics.rendering import rendering_advice, rendering_backend
from planspace.workers import count_cores

REQUIREMENT = re.compile(r"(?P<package>[\w.-]+).*?(extra == ['\"](?P<extra>\w+)['\"])?$")
"""A requirement in the package's metadata, such as `onnx>=1.21; extra == "onnx"`."""


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    name: str
    value: str
    ok: bool
    advice: str = ""
    """What to do if it is not ok."""

    def __str__(self) -> str:
        advice = f"  -> {self.advice}" if self.advice and not self.ok else ""
        return f"{'ok ' if self.ok else '-- '} {self.name:<16}{self.value}{advice}"


@dataclass(frozen=True)
class Doctor:
    """Show what is installed, what is missing, and how to install it."""

    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Examine the machine and print the findings."""
        findings = examine()
        if self.json:
            print_json(
                {f.name: {"value": f.value, "ok": f.ok, "advice": "" if f.ok else f.advice} for f in findings}
            )
        else:
            print(*findings, sep="\n")


def examine() -> list[Finding]:
    """Examine this machine, which takes a second or two."""
    requirements = _requirements()
    return [
        Finding("python", platform.python_version(), sys.version_info >= (3, 11), "install Python 3.11."),
        Finding("cores", str(count_cores()), True),
        Finding("planspace", version("planspace"), True),
        *(Finding(package, version(package), True) for package in requirements.pop("")),
        _batch(),
        _rendering(),
        *(_extra(name, packages) for name, packages in requirements.items()),
    ]


def _requirements() -> dict[str, list[str]]:
    """The packages that each extra installs, as pyproject.toml lists them; the base packages under ""."""
    found: dict[str, list[str]] = {"": []}
    for requirement in importlib.metadata.requires("planspace") or ():
        if parts := REQUIREMENT.match(requirement):
            found.setdefault(parts["extra"] or "", []).append(parts["package"])
    return found


def _extra(name: str, packages: list[str]) -> Finding:
    missing = [package for package in packages if not _is_installed(package)]
    value = f"missing: {', '.join(missing)}" if missing else f"found: {', '.join(packages)}"
    return Finding(f"[{name}]", value, not missing, f"pip install 'planspace[{name}]'")


def _is_installed(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


def _batch() -> Finding:
    found = importlib.util.find_spec("mujoco.batch") is not None
    value = "found" if found else "missing"
    return Finding("mujoco.batch", value, found, "pip install 'mujoco>=3.17,!=4.0.0'")


def _rendering() -> Finding:
    backend = rendering_backend()
    advice = f"only pictures of the robot need it: {rendering_advice()}"
    value = "none" if backend is None else f"works (MUJOCO_GL={backend})"
    return Finding("rendering", value, backend is not None, advice)
