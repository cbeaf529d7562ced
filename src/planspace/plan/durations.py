"""Durations in seconds and in physics steps.

Settings are in seconds, so that a system plans equally well whatever the time step of its model.
"""

from collections.abc import Mapping
from typing import Any

import mujoco

OLD_NAMES = {
    "min_edge_steps": "min_edge_s",
    "max_edge_steps": "max_edge_s",
    "max_steps": "max_s",
    "hold_steps": "hold_s",
}
"""Settings that version 0.1.0 saved in physics steps, and their names in seconds."""


def num_steps(seconds: float, model: mujoco.MjModel) -> int:
    """Return the number of physics steps that last about this long; at least 1."""
    return max(1, round(seconds / model.opt.timestep))


def in_seconds(settings: Mapping[str, Any], time_step: float) -> dict[str, Any]:
    """Convert settings in physics steps to settings in seconds.

    Args:
        settings: settings by name, flat (`sst_max_edge_steps`) or nested; others stay as they are.
        time_step: the model's time step [s].
    """
    converted: dict[str, Any] = {}
    for name, value in settings.items():
        old = next((old for old in OLD_NAMES if name == old or name.endswith(f"_{old}")), None)
        if old is not None and isinstance(value, int | float):
            converted[name.removesuffix(old) + OLD_NAMES[old]] = value * time_step
        else:
            converted[name] = in_seconds(value, time_step) if isinstance(value, Mapping) else value
    return converted
