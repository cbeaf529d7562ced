"""Comparing two compiled models, number by number."""

import mujoco
import numpy as np

UNRELATED = (
    "tex_",
    "ntex",
    "mat_",
    "light_",
    "cam_",
    "vis",
    "stat",
    "name",
    "path",
    "text_",
    "nname",
    "npath",
    "nbuffer",
)
"""Beginnings of the fields that hold text or pictures, which do not change the dynamics."""
ADDRESSES = "pathadr"
"""End of the fields that say where the text of a path begins."""


def different_fields(a: mujoco.MjModel, b: mujoco.MjModel) -> list[str]:
    """Return the names of the fields in which two models differ; pictures, cameras and text do not count.

    Args:
        a: a compiled model.
        b: another compiled model.
    """
    names = [n for n in dir(a) if not n.startswith(("_", *UNRELATED)) and not n.endswith(ADDRESSES)]
    arrays = [name for name in names if isinstance(getattr(a, name), np.ndarray | int | float)]
    found = [name for name in arrays if not np.array_equal(getattr(a, name), getattr(b, name))]
    options = [name for name in dir(a.opt) if not name.startswith("_")]
    return found + [
        f"opt.{name}" for name in options if not np.array_equal(getattr(a.opt, name), getattr(b.opt, name))
    ]
