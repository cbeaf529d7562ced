"""The controller: looks ahead from the present state by simulation, and acts by the best it finds."""

import contextlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.control.config import ControlConfig
from planspace.control.costs import Cost, DistanceCost, make_cost, support_note
from planspace.control.follow import PlanFollower
from planspace.control.ilqr import NUM_POLICIES, policies
from planspace.control.method import improved
from planspace.control.plant import Plant
from planspace.control.splines import spline_matrix
from planspace.control.takeover import Takeover
from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.errors import UsageError, quoted
from planspace.seams import check_kind
from planspace.tasks.problem import Problem
from planspace.tasks.task import Task

Act = Callable[[int, np.ndarray], np.ndarray]
"""(step, states [sample, state] after the steps before it) to controls [sample, control]."""

MOST_STEPS = 10_000
"""Largest number of control steps of a horizon."""


class Controller:
    """Receding-horizon control: `controller(state)` is the control for the next control step.

    It remembers the controls that it planned, so call it once for each step, and `reset` it for an episode.
    """

    def __init__(
        self,
        problem: str | Path | Problem | Task | Plant,
        embedding: Embedding | None = None,
        config: ControlConfig | None = None,
        *,
        plans: Demos | None = None,
        seed: int = 0,
        threads: int = 0,
    ):
        """Compile the model and prepare the look-ahead.

        Args:
            problem: a planning problem or a task, or the name or file of either.
            embedding: computes z; needed for the cost `z`.
            config: the settings.
            plans: what `follow_s` follows; needed and used only where it is above 0.
            seed: seed of the samples.
            threads: physics threads; 0 uses all CPUs. Results do not depend on it.

        Raises:
            UsageError: problem, embedding and settings do not fit together.
        """
        self.config = ControlConfig() if config is None else config
        check_kind("embedding", embedding, Embedding, ": load it first")
        check_kind("config", config, ControlConfig)
        check_kind("plans", plans, Demos, ": load them first")
        self.plant = Plant.find(problem).repeating(self.config.action_repeat)
        self.embedding = embedding
        num = max(self.config.samples, NUM_POLICIES) if self.config.ilqr_rounds else self.config.samples
        self._simulator = self.plant.simulator(num, threads)
        low, high = self._simulator.control_low, self._simulator.control_high
        if not (np.isfinite(low) & np.isfinite(high)).all():
            raise UsageError(
                "a control of the model has no limits, so that none can be sampled: give it a ctrlrange, or "
                "control_bounds in the problem file."
            )
        self._follower = _make_follower(self.plant, self.config, plans, threads)
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        self._make_splines()
        if note := support_note(self.plant, self.config, embedding):
            warnings.warn(note, stacklevel=2)
        self.reset(seed)

    def reset(
        self, seed: int | tuple[int, ...] = 0, target: Float[np.ndarray, " target"] | None = None
    ) -> None:
        """Forget the planned controls, for a new episode.

        Args:
            seed: seed of the samples.
            target: the goal of the episode, for a problem whose goals are drawn.

        Raises:
            UsageError: the target has another shape, or a number that is not finite.
        """
        size = self.plant.task.target_size
        if target is None:
            goal = np.empty(0)
        elif (goal := _finite(target, size)) is None:
            raise UsageError(f"the target must be {size} finite numbers, got {quoted(target)}.")
        self._target_missing = len(goal) < size
        self._rng = np.random.default_rng(seed)
        self._mean = np.zeros((self.config.knots, len(self._half)))
        self._cost: Cost = make_cost(self.plant, self.config, goal, self.embedding)
        goal_held = self.config.regulator and self.plant.problem.hold
        self._takeover = Takeover(self.plant, self.plant.goal(goal)) if goal_held else None
        if self._follower is not None:
            assert self._takeover is not None
            self._follower.start(self._takeover)
        self.regulated = False
        """Whether the regulator at the goal gave the last control."""
        self.followed = False
        """Whether the last control follows a plan."""

    def __call__(self, state: Float[np.ndarray, " state"]) -> Float[np.ndarray, " control"]:
        """Return the control to apply in this state for one control step.

        Raises:
            UsageError: the state has another shape, or a number that is not finite; or the goals of the task
                are drawn, and `reset` was not given one.
        """
        state = self._checked(state)
        given = None if self._takeover is None else self._takeover.control(state)
        self.regulated = given is not None
        if self._follower is not None:
            if given is None:
                given = self._follower.control(state)
            else:
                self._follower.leave()
        self.followed = given is not None and not self.regulated
        if given is not None:
            self._mean = np.tile((given - self._middle) / self._half, (self.config.knots, 1))
            return given
        mean, std = self._mean, np.full_like(self._mean, self.config.noise)
        for _ in range(getattr(self.config.method, "iterations", 1)):
            candidates = self._candidates(mean, std)
            controls = self._controls(candidates)
            costs = self._simulate(state, lambda step, _, u=controls: u[:, step], len(candidates))[2]
            mean, std = improved(self.config.method, std, candidates, costs)
        controls = self._controls(mean[None])[0]
        for _ in range(self.config.ilqr_rounds):
            controls = self._refined(state, controls)
        if self.config.ilqr_rounds:
            mean = self._knots @ ((controls - self._middle) / self._half)
        self._mean = self._shift @ mean
        return controls[0]

    def _checked(self, state: Any) -> Float[np.ndarray, " state"]:
        """The state as an array."""
        names = self.plant.space.names
        if self._target_missing:
            raise UsageError(
                f"the goals of {self.plant.task.name} are drawn: give the episode's with reset(target=...)."
            )
        found = _finite(state, len(names))
        if found is None:
            raise UsageError(
                f"the state must be {len(names)} finite numbers ({', '.join(names)}), got {quoted(state)}."
            )
        for first in self.plant.space.quaternion_columns:
            if not found[first : first + 4].any():
                four = ", ".join(names[first : first + 4])
                raise UsageError(f"the quaternion ({four}) of the state is zero, which is no rotation.")
        return found

    def _make_splines(self) -> None:
        """Compute what turns knots into controls, and shifts knots by a control step."""
        config, step = self.config, self.plant.control_step
        self.num_steps = round(config.horizon_s / step)
        """Control steps of the horizon."""
        if not 1 <= self.num_steps <= MOST_STEPS:
            raise UsageError(
                f"`horizon_s` must be at least one control step of {step:g} s and at most {MOST_STEPS:,} "
                f"({MOST_STEPS * step:g} s), got {config.horizon_s:g}."
            )
        last = (self.num_steps - 1) * step
        times = step * np.arange(self.num_steps)
        self._spline = spline_matrix(times, last, config.knots, config.spline)
        self._knots = np.linalg.pinv(self._spline)
        moved = np.linspace(0.0, last, config.knots) + step
        self._shift = spline_matrix(
            moved, last, config.knots, "linear" if config.spline == "cubic" else config.spline
        )

    def _candidates(self, mean: np.ndarray, std: np.ndarray) -> Float[np.ndarray, "sample knot control"]:
        """Knots around the mean, which is the first candidate."""
        noise = self._rng.standard_normal((self.config.samples, *mean.shape))
        if self.config.noise_color:
            noise = colored(noise, self.config.noise_color)
        if self.config.noise_spread > 1:
            noise *= self.config.noise_spread ** -self._rng.random((len(noise), 1, 1))
        noise[0] = 0.0
        return np.clip(mean + std * noise, -1.0, 1.0)

    def _controls(
        self, knots: Float[np.ndarray, "sample knot control"]
    ) -> Float[np.ndarray, "sample step control"]:
        """Turn knots into controls, within their limits."""
        return self._middle + self._half * np.clip(np.einsum("tk,skc->stc", self._spline, knots), -1.0, 1.0)

    def _refined(
        self, state: Float[np.ndarray, " state"], controls: Float[np.ndarray, "step control"]
    ) -> Float[np.ndarray, "step control"]:
        """Refine controls by a round of iLQR."""
        assert isinstance(self._cost, DistanceCost)
        states, controls, _ = (x[0] for x in self._simulate(state, lambda step, _: controls[None, step], 1))
        act = policies(self.plant, self._cost, self._simulator, states, controls)
        _, applied, costs = self._simulate(state, act, NUM_POLICIES)
        return applied[np.argmin(costs)]

    def _simulate(
        self, state: Float[np.ndarray, " state"], act: Act, num: int
    ) -> tuple[
        Float[np.ndarray, "sample time state"],
        Float[np.ndarray, "sample step control"],
        Float[np.ndarray, " sample"],
    ]:
        """Simulate from the present state, each simulation with its own controls.

        Args:
            state: the present state.
            act: gives the controls of a step.
            num: number of simulations.

        Returns:
            The states, the controls within their limits, and the costs.
        """
        simulator, config = self._simulator, self.config
        ids = None if num == simulator.num else np.arange(num, dtype=np.int32)
        states = np.empty((num, self.num_steps + 1, len(state)))
        controls = np.empty((num, self.num_steps, len(self._half)))
        states[:, 0] = state
        simulator.reset(states[:, 0], ids)
        invalid = np.zeros(num)
        for step in range(self.num_steps):
            given = act(step, states[:, step])
            controls[:, step] = np.clip(given, simulator.control_low, simulator.control_high)
            simulator.step(controls[:, step], self.plant.physics_steps, ids)
            states[:, step + 1] = simulator.states()[:num]
            invalid += ~simulator.allowed(num)
        diverged = simulator.diverged()[:num]
        states[diverged] = state
        costs = self._cost(states, controls) + config.invalid_cost * invalid / self.num_steps
        return states, controls, np.where(diverged, np.inf, costs)


def _finite(given: Any, size: int) -> Float[np.ndarray, " number"] | None:
    """A vector of so many finite numbers as an array; None if it is none."""
    with contextlib.suppress(TypeError, ValueError):
        array = np.asarray(given, dtype=float)
        if array.shape == (size,) and np.isfinite(array).all():
            return array
    return None


def _make_follower(
    plant: Plant, config: ControlConfig, plans: Demos | None, threads: int
) -> PlanFollower | None:
    """What follows plans; None if nothing does.

    Raises:
        UsageError: there are no plans, the goal is not held, or the plans do not fit.
    """
    if not config.follow_s:
        return None
    if plans is None:
        raise UsageError("follow_s needs plans to follow: give `plans`.")
    if not plant.problem.hold:
        raise UsageError(
            f"follow_s needs a goal that is held, but that of {plant.problem.name} is not (`hold: false`): "
            "leave follow_s out."
        )
    if config.follow_s < plant.control_step:
        raise UsageError(
            f"`follow_s` must be 0 or at least one control step of {plant.control_step:g} s, "
            f"got {config.follow_s:g}."
        )
    return PlanFollower(plant, plans, config.follow_s, threads)


def colored(
    noise: Float[np.ndarray, "sample knot control"], exponent: float
) -> Float[np.ndarray, "sample knot control"]:
    """Colour white noise along the knots; its power falls with this exponent of the frequency."""
    num = noise.shape[1]
    frequency = np.maximum(np.fft.rfftfreq(num), 1.0 / num)
    shape = frequency ** (-exponent / 2)
    found = np.fft.irfft(np.fft.rfft(noise, axis=1) * shape[:, None], num, axis=1)
    weights = np.full(len(shape), 2.0)
    weights[0] = 1.0
    if num % 2 == 0:
        weights[-1] = 1.0
    return found / np.sqrt((weights * shape**2).sum() / num)
