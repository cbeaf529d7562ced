"""What a controller minimises along its horizon."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.embed.embedding import Embedding, norm
from planspace.errors import UsageError
from planspace.physics.simulator import control_bounds
from planspace.tasks.problem import Goal

Cost = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(states [sample, time, state], controls [sample, step, control]) to the cost of each sample; the first
state is the present one."""
Measure = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""States [..., state] and [..., state] to the distance or time from the first to the second [...]."""
Distance = Callable[[np.ndarray], np.ndarray]
"""States [..., state] to their distance from the goal [...]."""


def make_cost(plant: Plant, config: ControlConfig, target: np.ndarray, embedding: Embedding | None) -> Cost:
    """Return the cost of candidates.

    Args:
        plant: what is controlled.
        config: which cost, and its weights.
        target: the goal of the episode, for a task whose goals are drawn; otherwise empty.
        embedding: computes z.

    Raises:
        UsageError: the cost needs an embedding, or its time head, and there is none, or the embedding reads
            other states.
    """
    if config.cost == "reward":
        return RewardCost(plant, target)
    if embedding is None:
        raise UsageError(
            f"the cost {config.cost} needs an embedding: give --embedding DIR, or --cost reward."
        )
    if config.cost == "time" and embedding.time_head is None:
        raise UsageError(
            "the cost time needs an embedding with a time head: train it with `planspace embed --time-head`."
        )
    columns = list(embedding.columns_of(plant.space.names, plant.space.units))
    between = {"z": embedding.distance, "raw": _input_distance(embedding), "time": embedding.time_to_go}
    measure = between[config.cost]
    goal = plant.goal(target)
    return DistanceCost(
        plant, config, goal_distance(plant, goal, lambda a, b: measure(a[..., columns], b[..., columns]))
    )


def goal_distance(plant: Plant, goal: Goal, measure: Measure) -> Distance:
    """Distance to the nearest state of the goal region."""
    if goal.weights.all() and not goal.half.any():
        return lambda states: measure(states, goal.center)

    return lambda states: measure(states, goal.nearest(states))


def _input_distance(embedding: Embedding) -> Measure:
    """Distance between two standardised states, which are what the encoder reads."""
    return lambda a, b: norm(embedding.inputs(a) - embedding.inputs(b))


def support_note(plant: Plant, config: ControlConfig, embedding: Embedding | None) -> str | None:
    """Say how far a fixed goal lies outside the region that the demonstrations cover.

    Returns:
        One sentence; None if the goal lies inside, goals are drawn, or the cost is not a distance in z.
    """
    support = None if embedding is None else embedding.support
    if embedding is None or support is None or config.cost not in ("z", "time") or plant.task.target_size:
        return None
    columns = list(embedding.columns_of(plant.space.names, plant.space.units))
    away = float(support.distance(embedding.inputs(plant.goal(np.empty(0)).center[columns])))
    if away <= support.radius:
        return None
    return (
        f"the goal lies outside the region that the embedding's demonstrations cover, {away:.2g} standard "
        f"deviations from the nearest of their states (the region ends at {support.radius:.2g}): z is a "
        "guess there."
    )


class DistanceCost:
    """The distance to the goal along the horizon and at its end, and the effort.

    The unit is the mean distance from where episodes start.
    """

    def __init__(self, plant: Plant, config: ControlConfig, distance: Distance):
        self.config = config
        self.distance = distance
        self._unit = float(distance(plant.starts).mean()) or 1.0
        low, high = control_bounds(plant.model, plant.space)
        self._largest = np.maximum(np.abs(low), np.abs(high))

    def __call__(
        self,
        states: Float[np.ndarray, "sample time state"],
        controls: Float[np.ndarray, "sample step control"],
    ) -> Float[np.ndarray, " sample"]:
        """Return the cost of each candidate."""
        config = self.config
        away = self.away(states[:, self._points(controls.shape[1])])
        effort = np.mean((controls / self._largest) ** 2, axis=(1, 2))
        return away.mean(axis=1) + config.terminal_weight * away[:, -1] + config.effort_weight * effort

    def away(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch"]:
        """The distance of states from the goal, in units of the mean distance of starts."""
        return self.distance(states) / self._unit

    def weights(self, steps: int) -> Float[np.ndarray, " time"]:
        """The weight of the distance in each state of a horizon of this many control steps."""
        points, weights = self._points(steps), np.zeros(steps + 1)
        np.add.at(weights, points, 1 / len(points))
        weights[-1] += self.config.terminal_weight
        return weights

    def effort_curvature(self, steps: int) -> Float[np.ndarray, " control"]:
        """Second derivative of the effort by each control of one step."""
        return 2 * self.config.effort_weight / (steps * len(self._largest) * self._largest**2)

    def _points(self, steps: int) -> Int[np.ndarray, " point"]:
        """The states of a horizon in which the distance counts."""
        points = np.round(np.linspace(0, steps, self.config.cost_points + 1)[1:]).astype(int)
        return np.maximum(np.unique(points), 1)


class RewardCost:
    """Minus the mean reward of the task along the horizon."""

    def __init__(self, plant: Plant, target: np.ndarray):
        self.task = plant.task
        self._target = target

    def __call__(
        self,
        states: Float[np.ndarray, "sample time state"],
        controls: Float[np.ndarray, "sample step control"],
    ) -> Float[np.ndarray, " sample"]:
        """Return the cost of each candidate."""
        samples, steps, size = controls.shape
        before, after = (
            states[:, :-1].reshape(-1, states.shape[-1]),
            states[:, 1:].reshape(-1, states.shape[-1]),
        )
        targets = np.broadcast_to(self._target, (len(before), len(self._target)))
        rewards = self.task.reward(before, after, controls.reshape(-1, size), targets)
        return -np.asarray(rewards).reshape(samples, steps).mean(axis=1)
