"""Compare positions with velocities, to find swapped columns, other units, a wrong time step and jumps.

A joint with velocity v moves by about v times the step. If it does not, the numbers probably mean something
else, or a demonstration begins in the middle of another.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from planspace.demos.episode import Episode
from planspace.demos.findings import Finding
from planspace.demos.state_info import StateInfo
from planspace.demos.survey import ROUNDING
from planspace.physics import quaternion
from planspace.physics.angles import TWO_PI, wrap

LEAST_CORRELATION, HIGH_CORRELATION = 0.5, 0.9
"""A position does not follow a velocity below the first correlation, and follows it above the second."""
AGREEING, EQUAL = 1.5, 0.05
"""A position that moves up to this many times as far as its velocity says agrees with it. Factors that differ
by less than the second number, relatively, are equal."""
LEAST_MOTION = 1e-4
"""Positions that move by less in a step, on average, are at rest [m or rad]."""
JUMP_OF_RANGE, JUMP_OF_STEPS = 0.2, 4.0
"""A jump differs from what the velocities say by this fraction of the range of the position, and by this many
average steps."""
MOST = 0.5
"""At least this fraction of the positions must disagree or jump: a gripper that opens in one step, or a cube
that is hit, disagrees alone."""
FEWEST_STEPS = 20
"""Fewer steps do not tell how positions and velocities belong together."""
LONG_STEP = 2.0
"""Steps that are this many times as long as the median are not compared: rows may be missing."""
DEGREES = 360 / TWO_PI
VELOCITY_ENDS = ("vel", "_vel", "_velocity", "dot", "_dot")
"""What the name of a velocity has after the name of its position, if there is no model."""
MAX_NAMES = 5
"""Number of states that a line names."""

QUATERNION_END = "_qw"
VELOCITY_ENDS_OF_ROTATION = ("_rxvel", "_ryvel", "_rzvel")
"""What follows the name of a ball or free joint, see `planspace.physics.joints`."""


class VelocityCheck:
    """The comparison, over all demonstrations."""

    def __init__(self, info: StateInfo):
        """Find the velocity of each position by the names of the states.

        Args:
            info: the states; angles on a circle are in radians.
        """
        self.info = info
        self.jumps = Finding()
        scalars, self._rotations = _find_scalars(info), _find_rotations(info)
        self._scalars = [position for position, _ in scalars]
        self._wrapped = np.zeros(len(scalars), dtype=bool)
        """Which of them are angles that stay within one turn, and may jump by a turn."""
        of_rotations = [first + 1 + k for first, _ in self._rotations for k in range(3)]
        self._positions = [*self._scalars, *of_rotations]
        """The column of each position; a rotation has three, which stand for its rotation vector."""
        self._velocities = [v for _, v in scalars] + [v for _, three in self._rotations for v in three]

    def notices(self, episodes: Callable[[], Iterator[Episode]]) -> list[str]:
        """Lines about what looks wrong; empty if positions and velocities agree.

        Args:
            episodes: returns an iterator over the demonstrations; it is called twice.
        """
        if not self._positions:
            return []
        spread = _Spread(len(self._positions))
        for episode in episodes():
            spread.add(episode.states[:, self._positions], self._motion(episode)[0])
        within = (spread.high - spread.low)[: len(self._scalars)] <= TWO_PI * (1 + ROUNDING)
        self._wrapped = within & np.isin(self._scalars, self.info.circular_columns)
        sums = _Sums(len(self._positions))
        for episode in episodes():
            self._compare(episode, spread.jump, sums)
        lines = self._explain(sums) if sums.num >= FEWEST_STEPS else []
        if self.jumps.count:
            jumps = self.jumps.text(
                "jump of a position that its velocity does not explain is kept",
                "jumps of positions that their velocities do not explain are kept",
            )
            lines.append(
                f"{jumps}; if demonstrations begin there, tell them apart with `offsets` or --episode."
            )
        return lines

    def _motion(self, episode: Episode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Changes of positions, velocities times the step at its start, and the same at its end."""
        steps = np.diff(episode.times)
        compared = steps <= LONG_STEP * np.median(steps) if len(steps) else np.zeros(0, dtype=bool)
        changes = self._changes(episode.states) * compared[:, None]
        durations = np.where(compared, steps, 0.0)[:, None]
        velocities = episode.states[:, self._velocities]
        return changes, durations * velocities[:-1], durations * velocities[1:]

    def _changes(self, states: Float[np.ndarray, "time state"]) -> Float[np.ndarray, "step pair"]:
        changes = np.diff(states[:, self._scalars], axis=0)
        changes[:, self._wrapped] = wrap(changes[:, self._wrapped])
        rotations = (quaternion.normalise(states[:, first : first + 4]) for first, _ in self._rotations)
        turns = (quaternion.log(quaternion.multiply(quaternion.conjugate(q[:-1]), q[1:])) for q in rotations)
        return np.concatenate([changes, *turns], axis=1)

    def _compare(self, episode: Episode, jump: Float[np.ndarray, " pair"], sums: "_Sums") -> None:
        changes, first, last = self._motion(episode)
        beyond = np.maximum(changes - np.maximum(first, last), np.minimum(first, last) - changes)
        jumps = np.minimum(beyond, np.abs(changes)) > jump
        calm = jumps.mean(axis=1) < MOST
        for row in np.flatnonzero(~calm).tolist():
            pair = int(np.argmax(jumps[row]))
            before, after = episode.states[row : row + 2, self._positions[pair]]
            place = f"{episode.place(row + 1)}: {self._position(pair)} from {before:.4g} to {after:.4g}"
            self.jumps.add(place)
        sums.add(changes[calm], (first[calm] + last[calm]) / 2, np.diff(episode.times)[calm])

    def _explain(self, sums: "_Sums") -> list[str]:
        """One line for each kind of disagreement."""
        correlation, factor = sums.correlation, sums.factor
        own = np.diag(correlation)
        moving = np.sqrt(np.maximum(sums.changes, sums.said) / sums.num) > LEAST_MOTION
        lost = moving & (own < LEAST_CORRELATION)
        followed = [(i, int(correlation[i].argmax())) for i in np.flatnonzero(lost).tolist()]
        followed = [(i, k) for i, k in followed if correlation[i, k] >= HIGH_CORRELATION]
        if len(followed) > 1:
            told = [f"{self._position(i)} moves as {self._velocity(k)} says" for i, k in followed]
            return [f"positions follow other velocities: {_listed(told)}; are joints in another order?"]
        if lost.sum() >= MOST * max(1, moving.sum()):
            names = [f"{self._position(i)} and {self._velocity(i)}" for i in np.flatnonzero(lost).tolist()]
            order = " (a quaternion is w, x, y, z)" if lost[len(self._scalars) :].any() else ""
            return [
                f"positions do not move as their velocities say: {_listed(names)}; are positions and "
                f"velocities swapped, or columns in another order{order}?"
            ]
        scaled = moving & (own >= HIGH_CORRELATION) & ((factor > AGREEING) | (factor < 1 / AGREEING))
        lines = []
        while scaled.any():
            same = scaled & _equal(factor, factor[np.argmax(scaled)])
            lines += self._scaled(same, float(factor[same].mean()), moving, sums)
            scaled &= ~same
        return lines

    def _scaled(
        self, same: Bool[np.ndarray, " pair"], factor: float, moving: Bool[np.ndarray, " pair"], sums: "_Sums"
    ) -> list[str]:
        """A line about positions that move by the same factor too far, if it has a likely reason."""
        first, names = int(np.argmax(same)), [self._position(i) for i in np.flatnonzero(same).tolist()]
        line = f"positions move {factor:.3g} times as far as their velocities say: {_listed(names)}; "
        if _equal(factor, DEGREES):
            return [f"{line}if positions are in degrees, give --unit {names[0]}=deg for each."]
        if _equal(factor, 1 / DEGREES):
            velocity = self._velocity(first)
            return [f"{line}if velocities are in degrees per second, give --unit {velocity}=deg/s for each."]
        if same.sum() > MOST * moving.sum():
            step = sums.duration / sums.num
            return [f"{line}is the time step {factor * step:.3g} s instead of {step:.3g} s?"]
        return []

    def _position(self, pair: int) -> str:
        return self.info.names[self._positions[pair]]

    def _velocity(self, pair: int) -> str:
        return self.info.names[self._velocities[pair]]


@dataclass
class _Spread:
    """Ranges and average steps of positions."""

    size: int
    num: int = 0

    def __post_init__(self) -> None:
        """Start without demonstrations."""
        self.low, self.high = np.full(self.size, np.inf), np.full(self.size, -np.inf)
        self.path = np.zeros(self.size)

    def add(self, positions: Float[np.ndarray, "time pair"], changes: Float[np.ndarray, "step pair"]) -> None:
        """Add a demonstration."""
        self.low = np.minimum(self.low, positions.min(axis=0))
        self.high = np.maximum(self.high, positions.max(axis=0))
        self.path += np.abs(changes).sum(axis=0)
        self.num += len(changes)

    @property
    def jump(self) -> Float[np.ndarray, " pair"]:
        """The smallest jump of each position."""
        average = self.path / max(1, self.num)
        return np.maximum(JUMP_OF_RANGE * (self.high - self.low), JUMP_OF_STEPS * average)


@dataclass
class _Sums:
    """Sums over steps of the changes of positions, and of those that the velocities say."""

    size: int
    num: int = 0
    duration: float = 0.0
    """Duration of all steps [s]."""
    changes: np.ndarray = field(init=False)
    """Squared changes of each position."""
    said: np.ndarray = field(init=False)
    """The same for what its velocity says."""
    both: np.ndarray = field(init=False)
    """The change of each position times what each velocity says."""

    def __post_init__(self) -> None:
        """Start without steps."""
        self.changes, self.said = np.zeros(self.size), np.zeros(self.size)
        self.both = np.zeros((self.size, self.size))

    def add(
        self,
        changes: Float[np.ndarray, "step pair"],
        said: Float[np.ndarray, "step pair"],
        steps: Float[np.ndarray, " step"],
    ) -> None:
        """Add the steps of a demonstration."""
        self.num, self.duration = self.num + len(steps), self.duration + float(steps.sum())
        self.changes += (changes**2).sum(axis=0)
        self.said += (said**2).sum(axis=0)
        self.both += changes.T @ said

    @property
    def correlation(self) -> Float[np.ndarray, "pair pair2"]:
        """Correlation of the change of each position with what each velocity says; 0 if one is at rest."""
        scale = np.sqrt(np.outer(self.changes, self.said))
        return np.divide(self.both, scale, out=np.zeros_like(scale), where=scale > 0)

    @property
    def factor(self) -> Float[np.ndarray, " pair"]:
        """How many times as far each position moves as its velocity says."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.sqrt(self.changes / self.said)


def _find_scalars(info: StateInfo) -> list[tuple[int, int]]:
    """Columns of positions that are no rotations, and of their velocities."""
    columns = {name: column for column, name in enumerate(info.names)}
    pairs = []
    for position, name in enumerate(info.names):
        ends = (columns.get(f"{name}{end}") for end in VELOCITY_ENDS)
        velocity = next((column for column in ends if column is not None), _numbered(name, columns))
        if velocity is not None and _units_fit(info.units[position], info.units[velocity]):
            pairs.append((position, velocity))
    return pairs


def _find_rotations(info: StateInfo) -> list[tuple[int, tuple[int, ...]]]:
    """First columns of quaternions, and the columns of their angular velocities in the frame of the body."""
    columns = {name: column for column, name in enumerate(info.names)}
    stems = [(first, info.names[first].removesuffix(QUATERNION_END)) for first in info.quaternion_columns]
    found = [(first, [columns.get(stem + end) for end in VELOCITY_ENDS_OF_ROTATION]) for first, stem in stems]
    return [(first, tuple(c for c in three if c is not None)) for first, three in found if None not in three]


def _numbered(name: str, columns: dict[str, int]) -> int | None:
    """The velocity of `qpos3`, `qvel3`, if there are as many of them as positions: no joint is a rotation."""
    numbers = [sum(other.startswith(kind) for other in columns) for kind in ("qpos", "qvel")]
    same = name.startswith("qpos") and numbers[0] == numbers[1]
    return columns.get(name.replace("qpos", "qvel", 1)) if same else None


def _units_fit(position: str, velocity: str) -> bool:
    """Whether a velocity is the time derivative of a position; without one of the units, in SI units."""
    if position and velocity:
        return velocity == f"{position}/s"
    return position in ("", "rad", "m") and velocity in ("", "rad/s", "m/s")


def _equal(factor: np.ndarray | float, other: float) -> np.ndarray:
    return np.asarray(np.abs(factor - other) <= EQUAL * other)


def _listed(texts: Sequence[str]) -> str:
    more = f" and {len(texts) - MAX_NAMES} more" if len(texts) > MAX_NAMES else ""
    return f"{', '.join(texts[:MAX_NAMES])}{more}"
