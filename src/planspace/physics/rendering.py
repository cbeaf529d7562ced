"""The OpenGL backend that MuJoCo can render with on this machine."""

import importlib
import os
import shutil
import subprocess
import sys
from typing import Any

BACKENDS = ("egl", "osmesa", "glfw", "cgl")
RENDER_PROBE = (
    'import mujoco; m = mujoco.MjModel.from_xml_string(\'<mujoco><worldbody><geom size="1"/></worldbody>'
    "</mujoco>'); r = mujoco.Renderer(m, 16, 16); r.update_scene(mujoco.MjData(m)); r.render()"
)
APT_PACKAGES = "libegl1 libopengl0 libgl1-mesa-dri"
"""Packages of Debian and Ubuntu that draw without a graphics card (newer ones have no OSMesa)."""


def rendering_backend() -> str | None:
    """Find the first OpenGL backend that works here, named as in MUJOCO_GL; None if no backend works.

    Each is tried in a subprocess, because a faulty GL driver may abort it.
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
    """Say what to do if no backend works."""
    chosen = os.environ.get("MUJOCO_GL")
    if chosen is not None:
        return (
            f"unset MUJOCO_GL, which is set to {chosen!r}, so that planspace looks for a backend that works"
        )
    if shutil.which("apt-get"):
        is_root = hasattr(os, "geteuid") and os.geteuid() == 0
        return f"{'' if is_root else 'sudo '}apt-get install {APT_PACKAGES}"
    return "install EGL and OpenGL, which come with Mesa or the driver of the graphics card"


def context_class(backend: str) -> Any:
    """The OpenGL context of a backend; values such as `on` mean the default of the platform."""
    import mujoco  # here, so that `planspace doctor` runs without it

    name = backend.lower().strip()
    return importlib.import_module(f"mujoco.{name}").GLContext if name in BACKENDS else mujoco.GLContext


def _backends() -> list[str]:
    if "MUJOCO_GL" in os.environ:
        return [os.environ["MUJOCO_GL"]]
    if sys.platform != "linux":
        return ["cgl", "glfw"] if sys.platform == "darwin" else ["glfw"]
    return ["glfw", "egl", "osmesa"] if os.environ.get("DISPLAY") else ["egl", "osmesa"]
