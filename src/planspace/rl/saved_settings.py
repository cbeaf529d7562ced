"""Settings of a training run as `config.json` holds them; settings that version 0.1.0 saved are read, too."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from planspace.errors import PlanspaceError, UsageError, quoted
from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms import ALGORITHMS, find_algorithm
from planspace.rl.config import TrainConfig
from planspace.seams import with_settings

OLD_NAMES = {"trace": "gae_lambda"}
"""Hyper-parameters that were renamed, old name to new name."""


def read_settings(saved: Mapping[str, Any], algorithm: Algorithm | None = None) -> tuple[str, TrainConfig]:
    """Read the task and the settings from a run's `config.json`.

    Args:
        saved: its content.
        algorithm: the algorithm, for a run that was trained by one that planspace does not ship.

    Returns:
        The name of the task, and the settings.

    Raises:
        PlanspaceError: the settings are damaged, or name an algorithm that is not shipped.
    """
    try:
        found = algorithm or _old_algorithm(saved) or _algorithm(saved["algorithm"])
        own = {f.name: saved[f.name] for f in fields(TrainConfig) if f.name in saved}
        return str(saved["task"]), TrainConfig(**{**own, "algorithm": found})
    except (KeyError, TypeError, ValueError) as error:
        raise PlanspaceError(f"these are not the settings of a training run: {quoted(error)}.") from error


def _algorithm(saved: Mapping[str, Any]) -> Algorithm:
    name = saved["name"]
    if name not in ALGORITHMS:
        raise UsageError(
            f"the run was trained by {quoted(name)}, which planspace does not ship. Pass that algorithm."
        )
    return with_settings(ALGORITHMS[name], **_leaves(saved, ALGORITHMS[name]))


def _old_algorithm(saved: Mapping[str, Any]) -> Algorithm | None:
    """The algorithm as version 0.1.0 saved it: `algo`, `preset`, and hyper-parameters in `learner`."""
    if "algo" not in saved:
        return None
    found, learner = find_algorithm(saved["algo"], saved["preset"]), saved.get("learner") or {}
    named = {OLD_NAMES.get(str(name), str(name)): value for name, value in learner.items()}
    own: dict[str, Any] = named.pop(str(saved["algo"]), {})
    return with_settings(found, **_leaves({**named, **own}, found))


def _leaves(saved: Mapping[str, Any], like: Any) -> dict[str, Any]:
    """Values by field name, nested groups flattened and lists made tuples, for the fields that `like` has."""
    found: dict[str, Any] = {}
    for field in fields(like):
        default = getattr(like, field.name)
        if is_dataclass(default):
            found |= _leaves(saved.get(field.name, saved), default)
        elif field.name in saved:
            value = saved[field.name]
            found[field.name] = tuple(value) if isinstance(value, list) else value
    return found
