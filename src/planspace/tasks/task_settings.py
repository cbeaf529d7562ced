"""The section `task` of a problem file: what turns a planning problem into a reinforcement learning task."""

from dataclasses import dataclass, field

from planspace.errors import UsageError, unknown
from planspace.tasks.observation_types import ObservationType

MAX_DISTANCE_COST = 5.0
"""Default upper bound on the cost of the distance to the goal in one step; that of `tasks.pose`."""


@dataclass(frozen=True)
class RewardSettings:
    """The reward of a step: -distance - effort, plus the bonus at the goal."""

    sparse: bool = False
    """Whether the reward is only 1 at the goal, and 0 elsewhere."""
    distance: tuple[float, ...] = ()
    """Cost of a metre or a radian away from the goal, for each degree of freedom, or also for each velocity;
    empty takes the mean over positions, weighted by `goal_weights`."""
    max_distance: float = MAX_DISTANCE_COST
    """Upper bound on the cost of the distance."""
    effort: float = 0.05
    """Cost of a step in which every control is at its limit; it grows with the square of the controls."""
    bonus: float = 1.0
    """Reward of a step that ends at the goal."""
    alive: float | None = None
    """Reward of a step that does not end the episode; None means `max_distance` for a task that can end
    early, so that ending an episode never pays, and 0 for others."""


@dataclass(frozen=True)
class Termination:
    """When an episode ends early. By default it never does."""

    bounds: bool = False
    """Whether it ends when a joint leaves its `position_bounds`."""
    contacts: bool = False
    """Whether it ends at a contact that `forbidden_contacts` forbids."""
    below: tuple[tuple[str, float], ...] = ()
    """It ends when a number of the state falls below its value: (name, value)."""

    @property
    def possible(self) -> bool:
        """Whether an episode can end early."""
        return self.bounds or self.contacts or bool(self.below)


@dataclass(frozen=True)
class TaskSettings:
    """What a reinforcement learning task has besides its planning problem."""

    horizon_s: float = 4.0
    """Length of an episode [s]."""
    control_step_s: float = 0.04
    """Time for which a control is held [s], rounded to physics steps."""
    observation: ObservationType = "raw"
    """What is observed of the state: `raw`, `wrapped` or `trig`. A random goal is always observed, too."""
    tolerance: float | None = None
    """A state is at the goal if the weighted distance of its positions is at most this; None takes that of
    the problem."""
    reward: RewardSettings = field(default_factory=RewardSettings)
    termination: Termination = field(default_factory=Termination)

    def frame_skip(self, timestep: float) -> int:
        """Physics steps for which a control is held."""
        return max(1, round(self.control_step_s / timestep))

    def horizon(self, timestep: float) -> int:
        """Steps of an episode.

        Raises:
            UsageError: an episode is shorter than a step.
        """
        step = self.frame_skip(timestep) * timestep
        if self.horizon_s < step * (1 - 1e-9):
            raise UsageError(
                f"task: horizon_s must be at least one control step ({step:g} s), got {self.horizon_s:g}."
            )
        return round(self.horizon_s / step)

    def check(self, names: tuple[str, ...], num_dofs: int, tangent_size: int) -> None:
        """Check that the settings fit a state space.

        Args:
            names: the names of the numbers of a state.
            num_dofs: the number of velocities.
            tangent_size: the number of values in a tangent.

        Raises:
            UsageError: they do not.
        """
        num = len(self.reward.distance)
        if num not in (0, num_dofs, tangent_size):
            raise UsageError(
                f"task: reward: distance must have {num_dofs} numbers, one for each degree of freedom, got "
                f"{num}."
            )
        for name, _ in self.termination.below:
            if name not in names:
                raise UsageError(f"task: termination: below: {unknown('number of the state', name, names)}")
