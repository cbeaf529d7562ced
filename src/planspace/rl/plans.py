"""Plans in training: states at which episodes start, and steps for a replay buffer."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.state_info import StateInfo
from planspace.envs.batch import TaskBatch
from planspace.envs.episodes import Episodes, TaskEpisodes
from planspace.envs.plan_starts import PlanStarts
from planspace.errors import UsageError
from planspace.mjcf.source import model_key
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.plan_steps import plan_steps
from planspace.rl.transitions import Transitions
from planspace.tasks.task import Task

NUM_SIMULATIONS = 256
"""States that are simulated or judged at once; results do not depend on it."""


@dataclass(frozen=True)
class Plans:
    """Plans that fit a task, and what its training takes from them."""

    config: TrainConfig
    """The settings of the run."""
    observer: Observer
    """What policy and critic observe."""
    task: Task
    """The task."""
    demos: Demos
    """The plans."""

    @classmethod
    def of(cls, config: TrainConfig, observer: Observer, given: Demos | str | Path | None) -> "Plans | None":
        """Load the plans of a run and check that they fit; None if the run uses none.

        Args:
            config: the settings.
            observer: what policy and critic observe.
            given: plans, or the folder of a dataset.

        Raises:
            UsageError: plans are missing or not used, or do not fit task and settings.
            PlanspaceError: there is no dataset, or it is damaged.
        """
        task = observer.task
        used = " and ".join(f"--{name}" for name in ("resets", "replay") if getattr(config, name))
        if given is None:
            if used:
                raise UsageError(f"{used} needs plans: give --plans DIR.")
            return None
        if not used:
            raise UsageError("plans were given, but nothing uses them: give --resets or --replay a fraction.")
        if not isinstance(task, Task):
            raise UsageError(
                f"{used} sets the state of an episode, which planspace cannot do in {task.name}: leave it "
                "out, or make the robot a task of your own (docs/howto/own-task.md)."
            )
        demos = given if isinstance(given, Demos) else load_demos(given)
        _check_states(task, demos.info)
        plans = cls(config, observer, task, demos)
        if config.replay:
            plans._check_steps("--replay")
        if not plans._alive.any():
            raise UsageError(f"{task.name} ends an episode at every state of the plans: give other plans.")
        return plans

    @property
    def hash(self) -> str:
        """SHA-256 of the plans."""
        return self.demos.hash

    def episodes(self, own: Episodes) -> Episodes:
        """Have the fraction `resets` of the episodes start at states of plans at which no episode ends."""
        if not self.config.resets:
            return own
        assert isinstance(own, TaskEpisodes)
        return PlanStarts(own, self._states[self._alive], self.config.resets)

    def transitions(self) -> Transitions | None:
        """Steps of the task along the plans, see `plan_steps`; None if `replay` is 0.

        Raises:
            UsageError: the plans have no such step.
        """
        if not self.config.replay:
            return None
        return plan_steps(self._in_task, self._batch, self.observer, self._alive)

    @cached_property
    def _in_task(self) -> Demos:
        """The plans with the states of the task in their order."""
        return self.demos.select(self.task.state_names)

    @cached_property
    def _states(self) -> Float[np.ndarray, "row state"]:
        """The states of all plans."""
        return self.task.space.normalise(self._in_task.states)

    @cached_property
    def _alive(self) -> Bool[np.ndarray, " row"]:
        """Whether an episode goes on at each state."""
        blocks = range(0, len(self._states), NUM_SIMULATIONS)
        ended = [self.task.terminated(self._states[first : first + NUM_SIMULATIONS]) for first in blocks]
        return ~np.concatenate(ended)

    @cached_property
    def _batch(self) -> TaskBatch:
        """Simulations of the task."""
        return TaskBatch(self.task, min(NUM_SIMULATIONS, len(self._states)), reward=self.config.reward)

    def _check_steps(self, option: str) -> None:
        """Check that steps along the plans can be computed.

        Args:
            option: the option that needs them, for messages.

        Raises:
            UsageError: they cannot.
        """
        if not self.demos.controls.any():
            raise UsageError(f"{option} needs the controls of the plans, but they have none: use --resets.")
        num_controls, found = self._batch.simulator.model.nu, self.demos.info.num_controls
        if found != num_controls:
            raise UsageError(
                f"{option} needs plans with the {num_controls} controls of {self.task.name}, but these have "
                f"{found}: use --resets."
            )
        if self.config.shaping != "none":
            raise UsageError(f"{option} has no shaping rewards: leave out --shaping, or use --resets.")
        if (count := len(self.observer.embeddings)) > 1:
            raise UsageError(f"{option} needs one embedding for all seeds, got {count}: use --resets.")


def _check_states(task: Task, info: StateInfo) -> None:
    """Check that plans are of the task's joints and, if they have a model, of its model.

    Raises:
        UsageError: they are not.
    """
    names, source = task.state_names, info.source
    missing = [name for name in names if name not in info.names]
    if missing or (source is not None and info.joints != task.joints):
        raise UsageError(
            f"the plans have the states ({', '.join(info.names)}), but {task.name} has "
            f"({', '.join(names)}): give plans of the same joints."
        )
    if source is not None and model_key(source) != model_key(task.source):
        raise UsageError(
            f"the plans were made with another model than that of {task.name}: give plans of the same model."
        )
