"""The seam for metrics: how far states are from a goal, for a search that extends the nodes nearest to it."""

from collections.abc import Callable
from typing import Any

import numpy as np

from planspace.errors import UsageError, quoted
from planspace.plan.planner import Planner
from planspace.plan.sst import SST
from planspace.seams import name_of
from planspace.tasks.source_hash import function_settings

Metric = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A function (states, goals) of two arrays [batch, state] that returns how far each state is from its goal
[batch], for example `embedding.time_to_go` or `embedding.distance`. Only the order of its values matters."""


def check_metric(metric: Any, planner: Planner) -> None:
    """Refuse a metric that is no function, and one that the planner would ignore.

    Raises:
        UsageError: the metric cannot be used.
    """
    if not callable(metric):
        raise UsageError(f"a metric is a function of two arrays of states, got {quoted(metric)}.")
    if name_of(planner).startswith("ompl-"):
        raise UsageError(
            f"{name_of(planner)} does not use a metric; {SST.name} does, and so can a planner of your own."
        )


def describe_metric(metric: Metric) -> dict[str, Any]:
    """The name of a metric, and the hash or content of the object that it belongs to, for manifests."""
    owner = getattr(metric, "__self__", metric)
    if isinstance(content := getattr(owner, "hash", None), str):
        return {"name": name_of(metric), "hash": content}
    return {"name": name_of(metric), "does": function_settings(metric)}


def checked_distances(metric: Metric, states: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """What a metric says, as numbers.

    Raises:
        UsageError: it does not return one finite number for each state.
    """
    found = np.asarray(metric(states, goals), dtype=float)
    if found.shape != (len(states),) or not np.isfinite(found).all():
        raise UsageError(
            f"the metric {name_of(metric)} must return one finite number for each of {len(states)} states, "
            f"got an array of shape {found.shape}."
        )
    return found
