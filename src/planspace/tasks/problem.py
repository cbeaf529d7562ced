"""Planning problems: a model, where plans start and end, which states are allowed, and what a plan costs."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.compile import GeomPairs, load_model
from planspace.mjcf.source import ModelSource, as_source, model_key
from planspace.physics.constraints import MAX_DEPTH
from planspace.physics.simulator import Simulator, Validity
from planspace.physics.space import DEFAULT_VELOCITY_BOUND, StateSpace
from planspace.storage.json_files import json_hash
from planspace.tasks.source_hash import function_settings
from planspace.tasks.task_settings import TaskSettings

IDLE_COST = 0.1
"""With the cost `effort`, a second at rest costs this fraction of one at full control, so that plans end."""
START_DRAWS = 1000
"""Draws of a start or a goal before a problem is reported to have no valid one."""


@dataclass(frozen=True)
class Box:
    """A box of states; a single state if low equals high."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def sample(self, rng: np.random.Generator) -> Float[np.ndarray, " state"]:
        """Draw a state uniformly from the box."""
        return rng.uniform(self.low, self.high)


@dataclass(frozen=True)
class Goal:
    """The goal region of one plan: a box around a state, and the distance from it that is tolerated."""

    space: StateSpace
    center: Float[np.ndarray, " state"]
    half: Float[np.ndarray, " tangent"]
    """Half the width of the box in each direction; zero for a single state."""
    weights: Float[np.ndarray, " tangent"]
    """Weight of each number of the difference; zero where every value is accepted."""
    tolerance: float
    """A state is in the goal region if its distance is at most this."""

    def distance(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch"]:
        """Return the weighted sum of the distances by which each number lies outside the box."""
        outside = np.abs(self.space.difference(states, self.center)) - self.half
        return np.asarray(np.maximum(outside, 0.0) @ self.weights)

    def nearest(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch state"]:
        """Return the state of the box that is nearest to each state, which keeps numbers of weight 0."""
        off = self.space.difference(states, self.center)
        inside = np.where(self.weights == 0, off, np.clip(off, -self.half, self.half))
        return self.space.integrate(self.center, inside)

    def reached(self, states: Float[np.ndarray, "*batch state"]) -> np.ndarray:
        """Return whether each state lies in the goal region."""
        return np.asarray(self.distance(states) <= self.tolerance)


@dataclass(frozen=True, repr=False)
class Problem:
    """A planning problem. States and tangents are those of `physics.space`."""

    name: str
    """Its name in manifests and messages."""
    model: ModelSource | str
    """The files of the model, or its MJCF text. It has no other joints than `joints` and held ones."""
    joints: tuple[str, ...]
    """The joints that make the state, in order."""
    start: Box
    """States where plans start [m, rad, m/s, rad/s]. Activations are 0 if it leaves them out."""
    goal: Box
    """States where plans end. Activations are free if it leaves them out."""
    tolerance: float
    """A state is at the goal if the weighted sum of its absolute differences from it is at most this."""
    goal_random: bool = False
    """Whether each plan gets one goal, drawn from the box; otherwise it may end anywhere in the box."""
    goal_weights: tuple[float, ...] = ()
    """Weight of each number of a tangent in the distance to the goal; empty means 1 for all. It may leave out
    the activations: their weight is 1 if `goal` has them, else 0."""
    feature_weights: tuple[float, ...] = ()
    """Weight of each number of a tangent in nearest-neighbour search; empty means 1 / range. It may leave out
    the activations."""
    body_features: tuple[tuple[str, float], ...] = ()
    """(body, weight) of bodies whose positions in the world count in nearest-neighbour search, too [1/m]."""
    sample_velocity: tuple[float, ...] = ()
    """Exploration draws each velocity within plus and minus these [m/s or rad/s]; empty means its bound."""
    velocity_bound: tuple[float, ...] = (DEFAULT_VELOCITY_BOUND,)
    """States with faster velocities are out of bounds [m/s or rad/s]: one bound for all, or one for each."""
    position_bounds: tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...] = ()
    """(joint, low, high) for joints that the model does not limit [m]."""
    limit_slack: float = 0.0
    """States may exceed the joint limits of the model by this much [m or rad]: MuJoCo's limits are soft."""
    control_bounds: Box | None = None
    """Bounds of the controls, within the model's own."""
    forbidden_contacts: Literal["none", "all"] | GeomPairs = "none"
    """Contacts that make a state invalid: none, all, or those between pairs of geoms."""
    predicate: Callable[[np.ndarray], np.ndarray] | None = None
    """Function of states [batch, state] to whether each is allowed [batch]; not in problem files."""
    hold: bool = True
    """Whether to check that the goal can be held."""
    kinematic: bool = False
    """Whether to plan only positions: controls are then velocities, and nothing has mass."""
    cost: Literal["duration", "effort"] = "duration"
    """The cost to minimise: the time of a plan, or its time weighted by the controls."""
    planner: str = "sst"
    """The name of the planner that suits the problem."""
    settings: tuple[tuple[str, Any], ...] = ()
    """Settings of the planner that differ from its defaults."""
    task: TaskSettings = field(default_factory=TaskSettings)
    """What makes it a reinforcement learning task, too. Plans do not depend on it."""

    def __repr__(self) -> str:
        """Return the name, the joints and the planner."""
        joints = self.joints if len(self.joints) <= 4 else (*self.joints[:3], "...")
        return f"Problem({self.name!r}, joints {', '.join(joints)}, planner {self.planner})"

    @property
    def source(self) -> ModelSource:
        """The files of the model."""
        return as_source(self.model)

    @property
    def validity(self) -> Validity:
        """What makes a state invalid, apart from its bounds."""
        return Validity(self.forbidden_contacts, self.predicate)

    def compile(self) -> tuple[mujoco.MjModel, StateSpace]:
        """Compile the model and read its state space.

        Raises:
            PlanspaceError: the model does not compile.
            UsageError: a joint, a geom or a bound does not fit the model.
        """
        model = load_model(self.model, self.validity.pairs)
        if self.control_bounds is not None:
            self._narrow_controls(model, self.control_bounds)
        bound = self.velocity_bound
        space = StateSpace.from_model(
            model,
            self.joints,
            velocity_bound=bound[0] if len(bound) == 1 else bound,
            position_bounds={name: (low, high) for name, low, high in self.position_bounds},
            kinematic=self.kinematic,
        )
        return model, self._widened(model, space) if self.limit_slack else space

    def _widened(self, model: mujoco.MjModel, space: StateSpace) -> StateSpace:
        """The space with `limit_slack` added to the bounds that are joint limits of the model."""
        own, slack = StateSpace.from_model(model, self.joints), self.limit_slack
        low = np.where(space.low == own.low, space.low - slack, space.low)
        return replace(space, low=low, high=np.where(space.high == own.high, space.high + slack, space.high))

    def _narrow_controls(self, model: mujoco.MjModel, bounds: Box) -> None:
        low, high = np.array(bounds.low), np.array(bounds.high)
        if self.kinematic:
            raise UsageError(
                "control_bounds cannot be used in a kinematic problem: velocity_bound bounds its controls."
            )
        if len(low) != model.nu:
            raise UsageError(f"control_bounds has {len(low)} numbers; the model has {model.nu} actuators.")
        limited, (least, most) = model.actuator_ctrllimited.astype(bool), model.actuator_ctrlrange.T
        if (low >= high).any() or (limited & ((low < least) | (high > most))).any():
            raise UsageError("control_bounds must have low < high, within the model's own control ranges.")
        model.actuator_ctrllimited[:] = 1
        model.actuator_ctrlrange[:] = np.transpose([low, high])

    def speed(self, space: StateSpace) -> Float[np.ndarray, " dof"]:
        """Return the fastest velocity of exploration for each degree of freedom [m/s or rad/s]."""
        return np.array(self.sample_velocity) if self.sample_velocity else space.velocity_bound

    def weights(self, space: StateSpace) -> Float[np.ndarray, " tangent"]:
        """Return the weights of nearest-neighbour search."""
        weights = space.default_weights(self.speed(space))
        weights[: len(self.feature_weights)] = self.feature_weights
        return weights

    def weights_to_goal(self, space: StateSpace) -> Float[np.ndarray, " tangent"]:
        """Return the weights of the distance to the goal."""
        weights = space.goal_weights
        if len(self.goal.low) == space.size:  # it has the activations
            weights[:] = 1.0
        weights[: len(self.goal_weights)] = self.goal_weights
        return weights

    def box(self, name: Literal["start", "goal"], space: StateSpace) -> Box:
        """Return the box of starts or goals, with activations of 0 if it leaves them out."""
        given: Box = getattr(self, name)
        left_out = (0.0,) * (space.size - len(given.low))
        return Box(given.low + left_out, given.high + left_out)

    def draw_start(self, simulator: Simulator, rng: np.random.Generator) -> Float[np.ndarray, " state"]:
        """Draw a valid start; it is moved to where the model's equalities hold.

        Raises:
            PlanspaceError: no draw was valid.
        """
        box = self.box("start", simulator.space)
        for _ in range(START_DRAWS):
            drawn = simulator.space.normalise(box.sample(rng))
            if (start := _possible(simulator, drawn)) is not None:
                return start
        raise PlanspaceError(
            f"problem {self.name}: no valid start in {START_DRAWS} draws: in each, bodies overlapped, an "
            "equality of the model could not hold, or it was in collision, out of bounds, or rejected by the "
            "predicate."
        )

    def draw_goal(
        self, space: StateSpace, rng: np.random.Generator, simulator: Simulator | None = None
    ) -> Goal:
        """Return the goal of one plan.

        Args:
            space: the problem's state space.
            rng: the stream that a random goal is drawn from.
            simulator: if given, a random goal is drawn again until it is valid; its states are overwritten.

        Raises:
            PlanspaceError: no draw was valid.
        """
        weights, box = self.weights_to_goal(space), self.box("goal", space)
        if self.goal_random:
            for _ in range(START_DRAWS):
                drawn = space.normalise(box.sample(rng))
                center = drawn if simulator is None else _possible(simulator, drawn)
                if center is not None:
                    return Goal(space, center, np.zeros(space.tangent_size), weights, self.tolerance)
            raise PlanspaceError(
                f"problem {self.name}: no valid goal in {START_DRAWS} draws: each was in collision or "
                "rejected by the predicate."
            )
        low, high = space.normalise(np.array(box.low)), space.normalise(np.array(box.high))
        half = 0.5 * _straight_difference(space, low, high)
        return Goal(space, space.integrate(low, half), half, weights, self.tolerance)

    def step_cost(
        self, simulator: Simulator, controls: Float[np.ndarray, "*batch control"]
    ) -> Float[np.ndarray, "*batch"]:
        """Return the cost of one physics step with each control [s]: its time, weighted for `effort`."""
        dt = simulator.model.opt.timestep
        if self.cost == "duration":
            return np.full(controls.shape[:-1], dt)
        largest = np.maximum(np.abs(simulator.control_low), np.abs(simulator.control_high))
        return np.asarray(dt * (IDLE_COST + (np.abs(controls) / largest).mean(axis=-1)))

    @property
    def hash(self) -> str:
        """SHA-256 of everything that plans depend on; of a predicate, see `tasks.source_hash`."""
        left_out = ("model", "task")
        own = {f.name: _plain(getattr(self, f.name)) for f in fields(self) if f.name not in left_out}
        if self.predicate is not None:
            own["predicate"] = _predicate_content(self.predicate)
        for name in ("body_features", "limit_slack"):
            if not own[name]:
                del own[name]  # problems without it keep the hash that earlier versions recorded
        return json_hash(own | model_key(self.source))


def _possible(simulator: Simulator, state: np.ndarray) -> np.ndarray | None:
    """The state, moved to where the model's equalities hold; None if it is not valid there."""
    constraints = simulator.constraints
    found = constraints.project(state)
    if (
        found is None
        or not simulator.valid_states(found[None])[0]
        or constraints.overlap(found).depth > MAX_DEPTH
    ):
        return None
    return found


def _straight_difference(space: StateSpace, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return high - low as a tangent, not the short way round a circle, because a box may span the circle."""
    delta = space.difference(high, low)
    for state, tangent, kind in space.layout:
        if kind == "circle":
            delta[tangent] = high[state] - low[state]
    return delta


def _predicate_content(predicate: Callable[[np.ndarray], np.ndarray]) -> dict[str, Any]:
    """The name of a predicate, what it does, and the attributes of the object whose method it is."""
    attributes = getattr(getattr(predicate, "__self__", None), "__dict__", {})
    return {
        "name": f"{predicate.__module__}:{getattr(predicate, '__qualname__', type(predicate).__qualname__)}",
        "does": function_settings(predicate),
        "attributes": function_settings(attributes),
    }


def _plain(value: Any) -> Any:
    return {"low": value.low, "high": value.high} if isinstance(value, Box) else value
