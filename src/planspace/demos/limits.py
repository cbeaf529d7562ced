"""Imported positions and controls that are beyond the limits of the model."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from planspace.demos.declare import Meaning
from planspace.demos.survey import Survey

MARGIN = 0.1
"""A number may be beyond the limits by this fraction of their range: limits of joints are soft in MuJoCo."""
MAX_NAMES = 5
"""Number of states or controls that a line names."""


def limit_notices(meaning: Meaning, survey: Survey) -> list[str]:
    """Lines about numbers that are far beyond the limits of the model; empty if there is no model.

    Args:
        meaning: the states of the dataset.
        survey: statistics of the states and controls of the source.
    """
    if meaning.info.source is None:
        return []
    model, space = meaning.info.compile()
    lines = []
    limited = [i for i in np.flatnonzero(model.jnt_limited).tolist() if model.joint(i).name in space.names]
    names = [model.joint(i).name for i in limited]
    states = [meaning.info.names.index(name) for name in names]
    columns, factors = [meaning.columns[i] for i in states], [meaning.factors[i] for i in states]
    recorded = np.stack([survey.low[columns], survey.high[columns]], axis=1) * np.array(factors)[:, None]
    if beyond := _beyond(names, recorded, model.jnt_range[limited]):
        lines.append(f"positions exceed the limits of their joints: {beyond}; are units and columns right?")
    if not space.kinematic and len(survey.control_low) == model.nu:
        limited = np.flatnonzero(model.actuator_ctrllimited).tolist()
        names = [model.actuator(i).name or f"control{i + 1}" for i in limited]
        recorded = np.stack([survey.control_low[limited], survey.control_high[limited]], axis=1)
        if beyond := _beyond(names, recorded, model.actuator_ctrlrange[limited]):
            lines.append(
                f"controls exceed the limits of their actuators: {beyond}; MuJoCo applies the limit."
            )
    return lines


def _beyond(
    names: Sequence[str], recorded: Float[np.ndarray, "name 2"], limits: Float[np.ndarray, "name 2"]
) -> str:
    """The numbers that leave their limits, with their ranges; empty if there are none.

    Args:
        names: what they are called.
        recorded: the smallest and largest of each; not finite if there are none.
        limits: lower and upper limit of each.
    """
    margin = MARGIN * (limits[:, 1] - limits[:, 0])
    outside = (recorded[:, 0] < limits[:, 0] - margin) | (recorded[:, 1] > limits[:, 1] + margin)
    told = []
    for i in np.flatnonzero(outside & np.isfinite(recorded).all(axis=1)).tolist():
        (low, high), (least, most) = recorded[i], limits[i]
        told.append(f"{names[i]} from {low:.4g} to {high:.4g} (limits {least:.4g} and {most:.4g})")
    more = f" and {len(told) - MAX_NAMES} more" if len(told) > MAX_NAMES else ""
    return ", ".join(told[:MAX_NAMES]) + more
