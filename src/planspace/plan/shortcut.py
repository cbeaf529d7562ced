"""Shortcuts by simulation: shorten a plan through contact, where a linear model is no guide.

A contact that begins or ends makes the dynamics jump, and there the linear model of the polish is wrong.
Here many changes of the controls are tried at once. Each is simulated from the start. The one that reaches
the goal first is kept if it is shorter than the plan:

1. A part of the plan is left out, and the rest follows earlier.
2. A part is replaced by one control for a shorter or an equal time.
3. Noise that changes slowly in time is added to the controls.

Two plans of equal length are compared by their distance to the goal one step before they arrive.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.physics.replay import advance
from planspace.physics.simulator import Simulator
from planspace.plan.config import PolishConfig
from planspace.plan.durations import num_steps
from planspace.plan.query import Query
from planspace.tasks.problem import Goal

LONGEST_CUT = 0.3
"""A part that is left out or replaced lasts up to this fraction of the plan."""
NOISE = (0.02, 0.5)
"""Smallest and largest standard deviation of the noise, as fractions of half a control's range."""
KNOTS_S = 0.05
"""Time between two knots of the noise; it is linear between them [s]."""
SIMULATED_STEPS = 20_000
"""Long plans are tried with fewer changes per round, so that a round takes about this many physics steps."""
LEAST_CHANGES = 64
"""Changes per round, whatever the length of the plan."""
PATIENCE = 6
"""The search ends after this many rounds in which the plan did not get shorter."""


class _Landed(NamedTuple):
    """A plan that reaches the goal."""

    controls: Float[np.ndarray, "step control"]
    before: float
    """Distance to the goal one step before the plan arrives."""

    def better_than(self, other: "_Landed") -> bool:
        """Whether this plan is shorter, or as long and nearer to the goal before its end."""
        return (len(self.controls), self.before) < (len(other.controls), other.before)


def has_contacts(query: Query, controls: Float[np.ndarray, "step control"]) -> bool:
    """Whether bodies touch while a plan is replayed."""
    data = mujoco.MjData(query.model)
    query.space.write_data(query.start, data)
    for control in controls:
        advance(query.model, data, query.space, control)
        if data.ncon:
            return True
    return False


class Shortcut:
    """Shortens plans to one goal by simulating changed controls."""

    def __init__(self, simulator: Simulator, goal: Goal, config: PolishConfig, rng: np.random.Generator):
        """Prepare the search.

        Args:
            simulator: one simulation per change; overwritten.
            goal: where plans end.
            config: the number of rounds, and the distance from the goal that is aimed at.
            rng: all randomness of the search.
        """
        self._simulator, self._goal, self._config, self._rng = simulator, goal, config, rng
        self._low, self._high = simulator.control_low, simulator.control_high
        self._knots = num_steps(KNOTS_S, simulator.model)

    def run(
        self, start: Float[np.ndarray, " state"], controls: Float[np.ndarray, "step control"]
    ) -> Float[np.ndarray, "shorter control"] | None:
        """Shorten a plan; None if no shorter one was found.

        Args:
            start: where it starts.
            controls: one per physics step; they reach the goal.
        """
        best = self._best(start, controls[None])
        if best is None:
            return None
        given, misses = len(best.controls), 0
        for _ in range(self._config.shortcut_rounds):
            length = len(best.controls)
            found = self._best(start, self._changed(best.controls))
            if found is not None and found.better_than(best):
                best = found
            misses = 0 if len(best.controls) < length else misses + 1
            if misses >= PATIENCE or len(best.controls) <= 1:
                break
        return best.controls if len(best.controls) < given else None

    def _changed(self, controls: np.ndarray) -> Float[np.ndarray, "candidate step control"]:
        """The plan with another change in each row."""
        num = int(np.clip(SIMULATED_STEPS // len(controls), LEAST_CHANGES, self._simulator.num)) // 4
        return np.concatenate(
            [
                self._without_part(controls, num),
                self._with_constant(controls, num),
                self._with_noise(controls, 2 * num),
            ]
        )

    def _parts(self, num: int, length: int) -> tuple[np.ndarray, np.ndarray]:
        """First step and number of steps of a random part for each row."""
        longest = max(1, round(LONGEST_CUT * length))
        sizes = np.exp(self._rng.uniform(0.0, np.log(longest + 1), num)).astype(int)
        return self._rng.integers(0, np.maximum(length - sizes, 0) + 1), sizes

    def _without_part(self, controls: np.ndarray, num: int) -> np.ndarray:
        first, sizes = self._parts(num, len(controls))
        steps = np.arange(len(controls))
        moved = steps + np.where(steps >= first[:, None], sizes[:, None], 0)
        return controls[np.minimum(moved, len(controls) - 1)]

    def _with_constant(self, controls: np.ndarray, num: int) -> np.ndarray:
        steps = np.arange(len(controls))
        first, sizes = self._parts(num, len(controls))
        kept = (sizes * self._rng.random(num)).astype(int) + 1
        moved = np.where(steps >= (first + kept)[:, None], steps + (sizes - kept).clip(0)[:, None], steps)
        rows = controls[np.minimum(moved, len(controls) - 1)]
        inside = (steps >= first[:, None]) & (steps < (first + kept)[:, None])
        drawn = self._rng.uniform(self._low, self._high, (num, controls.shape[1]))
        ends = np.where(self._rng.random(drawn.shape) < 0.5, self._low, self._high)
        drawn = np.where(self._rng.random((num, 1)) < 0.5, ends, drawn)
        return np.where(inside[..., None], drawn[:, None], rows)

    def _with_noise(self, controls: np.ndarray, num: int) -> np.ndarray:
        length, width = controls.shape
        knots = -(-length // self._knots) + 1
        low, high = np.log(NOISE)
        size = np.exp(self._rng.uniform(low, high, num))[:, None, None]
        noise = self._rng.normal(0.0, 1.0, (num, knots, width)) * size * 0.5 * (self._high - self._low)
        at, part = np.divmod(np.arange(length), self._knots)
        part = (part / self._knots)[None, :, None]
        added = (1.0 - part) * noise[:, at] + part * noise[:, at + 1]
        return np.clip(controls + added, self._low, self._high)

    def _best(self, start: np.ndarray, candidates: np.ndarray) -> _Landed | None:
        """The best of the candidates that reach the goal, cut where they do."""
        simulator, num = self._simulator, len(candidates)
        ids, running = np.arange(num, dtype=np.int32), np.ones(num, dtype=bool)
        simulator.reset(np.tile(start, (num, 1)), ids)
        limit = self._config.landing * self._goal.tolerance
        before = self._goal.distance(simulator.states()[:num])
        for step in range(candidates.shape[1]):
            moving = ids[running]
            simulator.step(candidates[moving, step], ids=moving)
            running &= simulator.allowed(num)
            distances = self._goal.distance(simulator.states()[:num])
            landed = running & (distances <= limit) & ~simulator.diverged()[:num]
            if landed.any():
                best = int(np.flatnonzero(landed)[before[landed].argmin()])
                return _Landed(candidates[best, : step + 1].copy(), float(before[best]))
            if not running.any():
                return None
            before = distances
        return None
