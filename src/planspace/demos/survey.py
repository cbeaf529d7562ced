"""What the numbers of a source look like: ranges, constants, angles that were wrapped, counters."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from planspace.demos.episode import Episode
from planspace.physics.angles import TWO_PI

ROUNDING = 1e-6
"""Relative tolerance on the period of an angle that is stored in float32."""
ROUNDING_STEP = 1e-9
"""A step shorter than this fraction of the largest value is rounding."""
SAME_STEP = 1e-3
"""Relative difference below which steps of a clock are equal."""
QUATERNION_SIZE, UNIT_LENGTH = 4, 1e-2
"""A quaternion may differ from length one by this much."""
PERIODS = {"rad": TWO_PI, "deg": 360.0}
"""Full turn of an angle in each unit."""


class Survey:
    """Statistics of all states and controls, updated one demonstration at a time."""

    def __init__(self, num_states: int, num_controls: int):
        """Start without demonstrations."""
        self.num_states = 0
        self.low = np.full(num_states, np.inf)
        self.high = np.full(num_states, -np.inf)
        self.control_low = np.full(num_controls, np.inf)
        self.control_high = np.full(num_controls, -np.inf)
        self.longest = 0.0
        """Longest demonstration [s]."""
        self.locked = np.ones(num_states, dtype=bool)
        """Whether each state is constant within every demonstration."""
        self.least_step = np.full(num_states, np.inf)
        """Shortest step of each state that is not 0."""
        self._path, self._num_steps, self._duration = np.zeros(num_states), 0, 0.0
        self._num_moving = np.zeros(num_states, dtype=int)
        self._step_low = np.full(num_states, np.inf)
        self._step_high = np.full(num_states, -np.inf)
        windows = max(0, num_states - QUATERNION_SIZE + 1)
        self._square_low, self._square_high = np.full(windows, np.inf), np.zeros(windows)
        self._wraps = {unit: _WrapEvidence(period, num_states) for unit, period in PERIODS.items()}

    def update(self, episode: Episode) -> None:
        """Add a demonstration."""
        states, controls = episode.states, episode.controls
        self.num_states += len(states)
        self.low = np.minimum(self.low, states.min(axis=0))
        self.high = np.maximum(self.high, states.max(axis=0))
        if len(controls):
            self.control_low = np.minimum(self.control_low, controls.min(axis=0))
            self.control_high = np.maximum(self.control_high, controls.max(axis=0))
        duration = float(episode.times[-1] - episode.times[0])
        self.longest, self._duration = max(self.longest, duration), self._duration + duration
        if len(self._square_low):
            windows = sliding_window_view(states**2, QUATERNION_SIZE, axis=1).sum(axis=-1)
            self._square_low = np.minimum(self._square_low, windows.min(axis=0))
            self._square_high = np.maximum(self._square_high, windows.max(axis=0))
        if len(states) < 2:
            return
        steps = np.diff(states, axis=0)
        self.locked &= (steps == 0).all(axis=0)
        length = np.abs(steps)
        moving = length > ROUNDING_STEP * np.maximum(np.abs(self.low), np.abs(self.high))
        self.least_step = np.minimum(self.least_step, np.where(moving, length, np.inf).min(axis=0))
        self._path, self._num_steps = self._path + length.sum(axis=0), self._num_steps + len(steps)
        self._num_moving += moving.sum(axis=0)
        self._step_low = np.minimum(self._step_low, steps.min(axis=0))
        self._step_high = np.maximum(self._step_high, steps.max(axis=0))
        for wraps in self._wraps.values():
            wraps.update(states, steps)

    @property
    def average_step(self) -> Float[np.ndarray, " state"]:
        """Average length of the steps of each state."""
        return self._path / max(1, self._num_steps)

    @property
    def average_duration(self) -> float:
        """Average duration of a step [s]."""
        return self._duration / max(1, self._num_steps)

    @property
    def moving(self) -> Float[np.ndarray, " state"]:
        """Fraction of the steps in which each state changes."""
        return self._num_moving / max(1, self._num_steps)

    @property
    def clocks(self) -> Bool[np.ndarray, " state"]:
        """Whether each state rises by the same amount in every row, as a time or a counter does."""
        return (self._step_low > 0) & (self._step_high - self._step_low <= SAME_STEP * self._step_high)

    def reach(self, column: int) -> float:
        """Largest absolute value of a state."""
        return float(max(abs(self.low[column]), abs(self.high[column])))

    def lengths(self, first: int) -> tuple[float, float]:
        """Shortest and longest vector of four neighbouring states.

        Args:
            first: the first of the four.
        """
        return float(np.sqrt(self._square_low[first])), float(np.sqrt(self._square_high[first]))

    def has_unit_length(self, first: int) -> bool:
        """Whether four neighbouring states have length one everywhere, as a quaternion."""
        return all(abs(length - 1) < UNIT_LENGTH for length in self.lengths(first))

    @property
    def constant(self) -> Bool[np.ndarray, " state"]:
        """Whether each state has the same value everywhere."""
        return self.low == self.high

    def wraps(self, column: int, unit: str) -> str:
        """The unit in which a state jumps by full turns; empty if it does not.

        Args:
            column: the state.
            unit: its unit if it is known; otherwise all are tried.
        """
        units = [unit] if unit in PERIODS else [] if unit else list(PERIODS)
        for name in units:
            if self._wraps[name].found(self.low, self.high)[column]:
                return name
        return ""


@dataclass
class _WrapEvidence:
    """Whether states are angles whose values jump by one period where they leave one turn.

    Such an angle has steps that are small, or small after one period is added or subtracted, and nothing
    between. The steps across the jump are no longer than five times the longest of the others: a switch,
    whose value also jumps, does not move otherwise.
    """

    period: float
    num: int

    def __post_init__(self) -> None:
        """Start without steps."""
        self.small = np.zeros(self.num)
        """Longest step that is shorter than a quarter of the period."""
        self.across = np.zeros(self.num)
        """Longest step across a jump, after a period was added or subtracted."""
        self.jumps = np.zeros(self.num, dtype=int)
        self.others = np.zeros(self.num, dtype=int)

    def update(self, states: Float[np.ndarray, "time state"], steps: Float[np.ndarray, "step state"]) -> None:
        """Add the steps of a demonstration."""
        length = np.abs(steps)
        quarter = self.period / 4
        jump = (length > 3 * quarter) & (length <= self.period * (1 + ROUNDING))
        small = length < quarter
        self.small = np.maximum(self.small, np.where(small, length, 0.0).max(axis=0))
        if jump.any():
            self.across = np.maximum(self.across, np.where(jump, self.period - length, 0.0).max(axis=0))
            self.jumps += jump.sum(axis=0)
        self.others += (~jump & ~small).sum(axis=0)

    def found(
        self, low: Float[np.ndarray, " state"], high: Float[np.ndarray, " state"]
    ) -> Bool[np.ndarray, " state"]:
        """Whether each state is such an angle.

        Args:
            low: smallest value of each state.
            high: largest value of each state.
        """
        slack = self.period * ROUNDING
        centred = (low >= -self.period / 2 - slack) & (high <= self.period / 2 + slack)
        positive = (low >= -slack) & (high <= self.period + slack)
        consistent = self.across <= 5 * self.small
        return (centred | positive) & (self.jumps > 0) & (self.others <= self.jumps // 10) & consistent
