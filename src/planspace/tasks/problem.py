"""Planning problems: a model, where plans start, where they end, what they must not do and what they cost."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.compile import GeomPairs, load_model
from planspace.physics.simulator import Simulator, Validity
from planspace.physics.space import DEFAULT_VELOCITY_BOUND, StateSpace
from planspace.storage.json_files import json_hash

IDLE_COST = 0.1
"""Effort counts a second of rest like a tenth of a second at full control, so that plans end."""
START_DRAWS = 1000
"""So many starts are drawn before a problem is said to have none that is valid."""


@dataclass(frozen=True)
class Box:
    """A box of states; a point where low equals high."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def sample(self, rng: np.random.Generator) -> Float[np.ndarray, " state"]:
        """Draws a state uniformly."""
        return rng.uniform(self.low, self.high)


@dataclass(frozen=True)
class Goal:
    """Where one plan is to end: a box about a state, and how far from it still counts as arrived."""

    space: StateSpace
    center: Float[np.ndarray, " state"]
    half: Float[np.ndarray, " tangent"]
    """Half the width of the box in each direction; zero for a state."""
    weights: Float[np.ndarray, " tangent"]
    """How much each number counts; zero where any value will do."""
    tolerance: float

    def distance(self, states: Float[np.ndarray, "*batch state"]) -> Float[np.ndarray, "*batch"]:
        """Weighted sum of how far each number lies outside the box."""
        outside = np.abs(self.space.difference(states, self.center)) - self.half
        return np.asarray(np.maximum(outside, 0.0) @ self.weights)

    def reached(self, states: Float[np.ndarray, "*batch state"]) -> np.ndarray:
        """Whether each state lies in the goal region."""
        return np.asarray(self.distance(states) <= self.tolerance)


@dataclass(frozen=True)
class Problem:
    """What to plan. States and tangents are those of `physics.space`."""

    name: str
    """What it is called in manifests and messages."""
    mjcf: str
    """The model's MJCF text; joints that are not planned for are held in it."""
    joints: tuple[str, ...]
    """The joints that make the state, in order."""
    start: Box
    """Where plans start [m, rad, m/s, rad/s]."""
    goal: Box
    """Where plans end."""
    tolerance: float
    """A plan has arrived when the weighted sum of absolute differences to its goal is at most this."""
    goal_random: bool = False
    """Draw a goal from the box for each plan; otherwise anywhere in the box will do."""
    goal_weights: tuple[float, ...] = ()
    """How much each number of a tangent counts in it; all 1 by default."""
    feature_weights: tuple[float, ...] = ()
    """How much each number counts when neighbours are searched; by default by its range."""
    sample_velocity: tuple[float, ...] = ()
    """Exploration draws each velocity within plus or minus these [m/s or rad/s]; by default its bound."""
    velocity_bound: tuple[float, ...] = (DEFAULT_VELOCITY_BOUND,)
    """Faster states are out of bounds [m/s or rad/s]: one bound for all, or one for each."""
    position_bounds: tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...] = ()
    """Joint, low and high [m] where the model itself sets no limits."""
    control_bounds: Box | None = None
    """Narrower bounds of the controls than the model's."""
    forbidden_contacts: Literal["none", "all"] | GeomPairs = "none"
    """Which contacts make a state invalid."""
    predicate: Callable[[np.ndarray], np.ndarray] | None = None
    """States to whether each is allowed; from Python only, a problem file names no code."""
    hold: bool = True
    """Whether it is checked that the goal can be held."""
    kinematic: bool = False
    """Plan positions alone: controls are velocities, and nothing has mass."""
    cost: Literal["duration", "effort"] = "duration"
    """What makes a plan good."""
    planner: str = "sst"
    """The planner that suits it."""
    settings: tuple[tuple[str, Any], ...] = ()
    """Settings of the planner that differ from its defaults."""

    @property
    def validity(self) -> Validity:
        """What a state must not do beside leaving its bounds."""
        return Validity(self.forbidden_contacts, self.predicate)

    def compile(self) -> tuple[mujoco.MjModel, StateSpace]:
        """Compiles the model and reads its state space.

        Raises:
            PlanspaceError: the model does not compile.
            UsageError: a joint, a geom or a bound does not fit the model.
        """
        model = load_model(self.mjcf, self.validity.pairs)
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
        return model, space

    def _narrow_controls(self, model: mujoco.MjModel, bounds: Box) -> None:
        low, high = np.array(bounds.low), np.array(bounds.high)
        if self.kinematic:
            raise UsageError("control_bounds: a kinematic problem's controls are bounded by velocity_bound.")
        if len(low) != model.nu:
            raise UsageError(f"control_bounds has {len(low)} numbers; the model has {model.nu} actuators.")
        limited, (least, most) = model.actuator_ctrllimited.astype(bool), model.actuator_ctrlrange.T
        if (low >= high).any() or (limited & ((low < least) | (high > most))).any():
            raise UsageError("control_bounds must have low < high, within the model's own control ranges.")
        model.actuator_ctrllimited[:] = 1
        model.actuator_ctrlrange[:] = np.transpose([low, high])

    def speed(self, space: StateSpace) -> Float[np.ndarray, " dof"]:
        """How fast exploration goes, for each degree of freedom [m/s or rad/s]."""
        return np.array(self.sample_velocity) if self.sample_velocity else space.velocity_bound

    def weights(self, space: StateSpace) -> Float[np.ndarray, " tangent"]:
        """The weights of neighbour search."""
        return (
            np.array(self.feature_weights)
            if self.feature_weights
            else space.default_weights(self.speed(space))
        )

    def draw_start(self, simulator: Simulator, rng: np.random.Generator) -> Float[np.ndarray, " state"]:
        """Draws a valid start.

        Raises:
            PlanspaceError: none was found.
        """
        for _ in range(START_DRAWS):
            start = simulator.space.normalise(self.start.sample(rng))
            if simulator.valid_states(start[None])[0]:
                return start
        raise PlanspaceError(
            f"problem {self.name}: no valid start in {START_DRAWS} draws: all are in collision, out of "
            "bounds, or refused by the predicate."
        )

    def draw_goal(
        self, space: StateSpace, rng: np.random.Generator, simulator: Simulator | None = None
    ) -> Goal:
        """The goal of one plan.

        Args:
            space: the problem's state space.
            rng: draws a random goal.
            simulator: to draw a random goal again until it is valid; overwritten.

        Raises:
            PlanspaceError: no valid goal was found.
        """
        weights = np.array(self.goal_weights) if self.goal_weights else np.ones(space.tangent_size)
        if self.goal_random:
            for _ in range(START_DRAWS):
                center = space.normalise(self.goal.sample(rng))
                if simulator is None or simulator.valid_states(center[None])[0]:
                    return Goal(space, center, np.zeros(space.tangent_size), weights, self.tolerance)
            raise PlanspaceError(
                f"problem {self.name}: no valid goal in {START_DRAWS} draws: all are in collision or refused."
            )
        low, high = space.normalise(np.array(self.goal.low)), space.normalise(np.array(self.goal.high))
        half = 0.5 * _straight_difference(space, low, high)
        return Goal(space, space.integrate(low, half), half, weights, self.tolerance)

    def step_cost(
        self, simulator: Simulator, controls: Float[np.ndarray, "*batch control"]
    ) -> Float[np.ndarray, "*batch"]:
        """What one physics step under each control costs [s]: its time, or its share of the full control."""
        dt = simulator.model.opt.timestep
        if self.cost == "duration":
            return np.full(controls.shape[:-1], dt)
        largest = np.maximum(np.abs(simulator.control_low), np.abs(simulator.control_high))
        return np.asarray(dt * (IDLE_COST + (np.abs(controls) / largest).mean(axis=-1)))

    @property
    def hash(self) -> str:
        """SHA-256 of everything that defines the problem."""
        return json_hash({f.name: _plain(getattr(self, f.name)) for f in fields(self)})


def _straight_difference(space: StateSpace, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """High - low as a tangent, without taking the short way round a circle: a box may span it."""
    delta = space.difference(high, low)
    for state, tangent, kind in space.layout:
        if kind == "circle":
            delta[tangent] = high[state] - low[state]
    return delta


def _plain(value: Any) -> Any:
    if isinstance(value, Box):
        return {"low": value.low, "high": value.high}
    return f"{value.__module__}:{value.__qualname__}" if callable(value) else value
