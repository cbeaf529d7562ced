"""Plans in training: states at which episodes start, and steps of the task along plans."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.state_info import StateInfo
from planspace.envs.episodes import Episodes
from planspace.envs.plan_starts import PlanStarts, StartStates
from planspace.errors import UsageError
from planspace.mjcf.source import model_key
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.plan_steps import plan_steps
from planspace.rl.progress import Progress
from planspace.rl.settable import Settable, SettableGym, find_settable
from planspace.rl.transitions import Transitions
from planspace.tasks.gymnasium import AnyTask
from planspace.tasks.task import Task

LEAST_DURATION = 1e-9
"""Durations are at least this [s], so that plans of one state can be divided by theirs."""


@dataclass(frozen=True)
class Plans:
    """Plans that fit a task, and what its training takes from them."""

    config: TrainConfig
    """The settings of the run."""
    observer: Observer
    """What policy and critic observe."""
    settable: Settable
    """Sets the states of the task and takes its steps."""
    demos: Demos
    """The plans."""
    progress: Progress | None = None
    """Computes the rewards of steps, if they are not the task's."""

    @classmethod
    def of(
        cls,
        config: TrainConfig,
        observer: Observer,
        given: Demos | str | Path | None,
        progress: Progress | None = None,
    ) -> "Plans | None":
        """Load the plans of a run and check that they fit; None if the run uses none.

        Args:
            config: the settings.
            observer: what policy and critic observe.
            given: plans, or the folder of a dataset.
            progress: computes the rewards of steps, if they are not the task's.

        Raises:
            UsageError: plans are missing or not used, or do not fit task and settings.
            PlanspaceError: there is no dataset, or it is damaged.
        """
        task = observer.task
        used = " and ".join(f"--{name.replace('_', '-')}" for name in config.uses_of_plans)
        if given is None:
            if used:
                raise UsageError(f"{used} need{'' if ' and ' in used else 's'} plans: give --plans DIR.")
            return None
        if not used:
            raise UsageError(
                "plans were given, but nothing uses them: give --resets or --replay a fraction, or --clone "
                "or --clone-weight a number."
            )
        settable = find_settable(task, config.task_reward)
        if settable is None:
            raise UsageError(
                f"{used} sets the state of an episode, which {task.name} does not allow: leave it out. "
                "See docs/howto/gymnasium-task.md."
            )
        demos = given if isinstance(given, Demos) else load_demos(given)
        _check_states(task, settable.names, demos.info)
        plans = cls(config, observer, settable, demos, progress)
        plans._check_steps()
        if not plans._alive.any():
            raise UsageError(f"{task.name} ends an episode at every state of the plans: give other plans.")
        if config.resets:
            plans._check_starts()
        return plans

    @property
    def hash(self) -> str:
        """SHA-256 of the plans."""
        return self.demos.hash

    def episodes(self, own: Episodes) -> Episodes:
        """Have the fraction `resets` of the episodes start at states of plans at which no episode ends."""
        if not self.config.resets:
            return own
        return PlanStarts(own, self._starts, self.config.resets)

    def transitions(self) -> Transitions | None:
        """Steps of the task along the plans, see `plan_steps`; None if nothing uses them.

        Raises:
            UsageError: the plans have no such step.
        """
        if not self._step_options:
            return None
        noise = self.config.plan_noise
        return plan_steps(self._in_task, self.settable, self.observer, self._alive, self.progress, noise)

    @property
    def task(self) -> AnyTask:
        """The task."""
        return self.observer.task

    @cached_property
    def _in_task(self) -> Demos:
        """The plans with the states that are set, in their order."""
        return self.demos.select(self.settable.names)

    @cached_property
    def _states(self) -> Float[np.ndarray, "row state"]:
        """The states of all plans."""
        return self.settable.normalise(self._in_task.states)

    @cached_property
    def _alive(self) -> Bool[np.ndarray, " row"]:
        """Whether an episode goes on at each state of the plans."""
        return self.settable.goes_on(self._states)

    @cached_property
    def _starts(self) -> StartStates:
        """The states at which episodes start."""
        plans = self._states[self._alive]
        if self.config.reset_schedule == "reverse":
            left = self._remaining[self._alive]
            order = np.argsort(left, kind="stable")
            return StartStates(plans[order], left[order])
        if self.config.reset_states == "plans":
            return StartStates(plans)
        trees = self.settable.normalise(np.concatenate([tree.states for tree in self._in_task.trees]))
        trees = trees[self.settable.goes_on(trees)]
        if self.config.reset_states == "trees":
            return StartStates(trees)
        num = max(len(plans), len(trees))  # repeated, so that half of the starts are from each
        return StartStates(np.concatenate([np.resize(part, (num, part.shape[1])) for part in (plans, trees)]))

    @cached_property
    def _remaining(self) -> Float[np.ndarray, " row"]:
        """Fraction of its plan that is left at each state."""
        demos = self.demos
        durations = demos.times[demos.offsets[1:] - 1]
        return 1.0 - demos.times / np.repeat(np.maximum(durations, LEAST_DURATION), np.diff(demos.offsets))

    @property
    def _step_options(self) -> tuple[str, ...]:
        """The options that need steps along the plans."""
        return tuple(f"--{x.replace('_', '-')}" for x in self.config.uses_of_plans if x != "resets")

    def _check_starts(self) -> None:
        """Check that the plans have the states at which episodes are to start.

        Raises:
            UsageError: they do not.
        """
        if self.config.reset_states == "plans":
            return
        if not self.demos.trees:
            raise UsageError(
                f"--reset-states {self.config.reset_states} needs search trees, but these plans have none: "
                "plan with --keep-trees, or start at the states of plans."
            )
        if not len(self._starts.states):
            raise UsageError(f"{self.task.name} ends an episode at every state of the trees: give others.")

    def _check_steps(self) -> None:
        """Check that steps along the plans can be computed, if they are needed.

        Raises:
            UsageError: they cannot.
        """
        if not self._step_options:
            return
        option = self._step_options[0]
        if not self.demos.controls.any():
            raise UsageError(f"{option} needs the controls of the plans, but they have none: use --resets.")
        num_controls, found = len(self.settable.limits[0]), self.demos.info.num_controls
        if found != num_controls:
            raise UsageError(
                f"{option} needs plans with the {num_controls} controls of {self.task.name}, but these have "
                f"{found}: use --resets."
            )
        own = self.settable
        if self.config.plan_noise and isinstance(own, SettableGym) and not own.driven.any():
            raise UsageError(
                "--plan-noise works for tasks of planspace, and for MuJoCo environments whose actuators are "
                f"all position servos, unlike {self.task.name}: leave it out."
            )
        if self.config.replay and self.config.shaping != "none":
            raise UsageError("--replay has no shaping rewards: leave out --shaping, or use --resets.")
        used = self.observer.embeddings or (self.progress.embeddings if self.progress else ())
        if (count := len(used)) > 1:
            raise UsageError(f"{option} needs one embedding for all seeds, got {count}: use --resets.")


def _check_states(task: AnyTask, names: tuple[str, ...], info: StateInfo) -> None:
    """Check that plans have the states that are set and, if they have a model, the task's.

    Raises:
        UsageError: they do not.
    """
    source, missing = info.source, [name for name in names if name not in info.names]
    own = task if isinstance(task, Task) and source else None  # models of Gymnasium are not compared
    if missing or (own and info.joints != own.joints):
        raise UsageError(
            f"the plans have the states ({', '.join(info.names)}), but {task.name} has "
            f"({', '.join(names)}): give plans of the same joints."
        )
    if own and source and model_key(source) != model_key(own.source):
        raise UsageError(
            f"the plans were made with another model than that of {task.name}: give plans of the same model."
        )
