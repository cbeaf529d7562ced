"""`planspace doctor`: what is installed, what is missing, and how to install it."""

import importlib.metadata
import importlib.util
import os
import platform
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from packaging.requirements import Requirement

from planspace.cli.tables import print_json
from planspace.errors import install_command
from planspace.physics.rendering import rendering_advice, rendering_backend
from planspace.workers import count_cores

WHEELS = {
    "ompl": ((3, 12), ("linux", "darwin")),
    "dm_control": ((3, 12), ("linux", "darwin", "win32")),  # because of labmaze
    "atheris": ((3, 14), ("linux",)),
}
"""Packages without wheels for some Python or system: the newest Python, and the systems (`sys.platform`)."""


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
    requirements = _requirements("planspace")
    return [
        Finding("python", platform.python_version(), sys.version_info >= (3, 11), "install Python 3.11."),
        Finding("cores", str(count_cores()), True),
        Finding("planspace", version("planspace"), True),
        *map(_package, requirements.pop("")),
        _batch(),
        _rendering(),
        *(_extra(name, needed) for name, needed in requirements.items()),
    ]


def _requirements(package: str) -> dict[str, list[Requirement]]:
    """What each extra of an installed package needs on this machine; under "" what it always needs."""
    about = importlib.metadata.metadata(package)
    found: dict[str, list[Requirement]] = {extra: [] for extra in ("", *about.get_all("Provides-Extra", []))}
    for requirement in map(Requirement, importlib.metadata.requires(package) or ()):
        for extra, needed in found.items():
            if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
                needed.append(requirement)
                break
    return found


def _faults(requirement: Requirement) -> list[str]:
    """What is missing or has a version that does not fit, for messages; empty if all is well."""
    name = requirement.name
    try:
        found = version(name)
    except PackageNotFoundError:
        return [name]
    if not requirement.specifier.contains(found, prereleases=True):
        return [f"{name}{requirement.specifier} (found {found})"]
    extras = _requirements(name) if requirement.extras else {}
    return [
        fault for extra in requirement.extras for needed in extras.get(extra, ()) for fault in _faults(needed)
    ]


def _package(requirement: Requirement) -> Finding:
    """The finding for a package that planspace always needs."""
    name, faults = requirement.name, _faults(requirement)
    value = f"missing: {', '.join(faults)}" if faults else version(name)
    return Finding(name, value, not faults, f"pip install '{name}{requirement.specifier}'")


def _extra(extra: str, needed: list[Requirement]) -> Finding:
    faults = list(dict.fromkeys(fault for requirement in needed for fault in _faults(requirement)))
    value = f"missing: {', '.join(faults)}" if faults else f"found: {', '.join(r.name for r in needed)}"
    without_wheel = [name for name in faults if not _has_wheel(name)]
    advice = "; ".join(map(_no_wheel, without_wheel)) or install_command(extra)
    return Finding(f"[{extra}]", value, not faults, advice)


def _has_wheel(package: str) -> bool:
    newest, systems = WHEELS.get(package, (sys.version_info[:2], (sys.platform,)))
    return sys.version_info[:2] <= newest and sys.platform in systems


def _no_wheel(package: str) -> str:
    (major, minor), systems = WHEELS[package]
    return f"{package} needs Python {major}.{minor} or older on {', '.join(systems)}: it has no other wheels"


def _batch() -> Finding:
    advice = "pip install 'mujoco>=3.17,!=4.0.0'"
    try:
        found = importlib.util.find_spec("mujoco.batch") is not None  # imports mujoco
    except Exception as error:  # such as a missing OpenGL library
        chosen = os.environ.get("MUJOCO_GL")
        fix = advice if chosen is None else f"unset MUJOCO_GL, which is set to {chosen!r}"
        return Finding("mujoco.batch", f"MuJoCo cannot be imported ({type(error).__name__})", False, fix)
    return Finding("mujoco.batch", "found" if found else "missing", found, advice)


def _rendering() -> Finding:
    backend = rendering_backend()
    if backend is None:
        return Finding(
            "rendering", "none", False, f"only pictures of the robot need it: {rendering_advice()}"
        )
    # the command line finds the backend itself, but `mujoco.Renderer` in a program of yours does not
    return Finding("rendering", f"works; set MUJOCO_GL={backend} in your own programs", True)
