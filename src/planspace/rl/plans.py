"""Plans in training: states at which episodes start, and steps for a replay buffer."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.load import load_demos
from planspace.demos.state_info import StateInfo
from planspace.envs.batch import TaskBatch
from planspace.envs.episodes import Episodes, TaskEpisodes
from planspace.envs.plan_starts import PlanStarts
from planspace.errors import UsageError
from planspace.mjcf.source import model_key
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.transitions import Transitions
from planspace.tasks.task import Task

NUM_SIMULATIONS = 256
"""Transitions that are simulated at once; results do not depend on it."""
TIME_TOLERANCE = 1e-6
"""Steps by which a plan may end too early for its last transition; times are rounded."""


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
        if config.replay:
            _check_replay(config, observer, task, demos)
        plans = cls(config, observer, task, demos)
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
        """One step of the task from each state of the plans; None if `replay` is 0.

        The control of a step is the plan's, averaged over the step and clipped to its limits. The simulation
        of the task gives the next state. Steps that start where an episode would have ended are left out, and
        so are those that last beyond the end of their plan and those whose physics diverge. Targets are drawn
        as the task draws them.

        Raises:
            UsageError: no step remains.
        """
        if not self.config.replay:
            return None
        rows, controls = self._controls
        keep = self._alive[rows]
        return self._simulate(self._states[rows[keep]], controls[keep])

    @cached_property
    def _states(self) -> Float[np.ndarray, "row state"]:
        """The states of all plans, in the order of the task."""
        return self.task.space.normalise(self.demos.select(self.task.state_names).states)

    @cached_property
    def _alive(self) -> Bool[np.ndarray, " row"]:
        """Whether an episode goes on at each state."""
        blocks = range(0, len(self._states), NUM_SIMULATIONS)
        ended = [self.task.terminated(self._states[first : first + NUM_SIMULATIONS]) for first in blocks]
        return ~np.concatenate(ended)

    @property
    def _controls(self) -> tuple[Int[np.ndarray, " step"], Float[np.ndarray, "step control"]]:
        """Row of the state and control of each step that ends within its plan."""
        model, _ = self.task.compile()
        duration = self.task.frame_skip * float(model.opt.timestep)
        parts = [average_controls(self.demos.episode(i), duration) for i in range(len(self.demos))]
        starts = self.demos.offsets[:-1]
        rows = [start + np.arange(len(part)) for start, part in zip(starts, parts, strict=True)]
        return np.concatenate(rows), np.concatenate(parts)

    def _simulate(
        self, states: Float[np.ndarray, "step state"], controls: Float[np.ndarray, "step control"]
    ) -> Transitions:
        """The steps from these states with these controls."""
        batch = TaskBatch(self.task, min(NUM_SIMULATIONS, max(1, len(states))), reward=self.config.reward)
        low, high = batch.simulator.control_low, batch.simulator.control_high
        actions = np.clip(controls, low, high).astype(np.float32)
        _, targets = self.task.sample_starts(len(states), np.random.default_rng(0))
        observe, size, parts = replace(self.observer, num_seeds=1), len(batch.states), []
        for first in range(0, len(states), size):
            rows = np.minimum(np.arange(first, first + size), len(states) - 1)  # the last is repeated
            batch.reset(states[rows], targets[rows])
            obs = observe(batch.states, batch.targets)
            rewards, terminated, diverged = batch.step(actions[rows])
            step = Transitions(obs, actions[rows], rewards, observe(batch.states, batch.targets), terminated)
            kept = ~diverged[: len(states) - first]
            parts.append([array[: len(kept)][kept] for array in step])
        if not sum(len(part[0]) for part in parts):
            raise UsageError("the plans have no step of the task that --replay could use: give longer plans.")
        return Transitions(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def average_controls(episode: Episode, duration: float) -> Float[np.ndarray, "step control"]:
    """Average the controls of a plan over a step of this duration from each of its states.

    Args:
        episode: the plan.
        duration: the duration of a step [s].

    Returns:
        The control of each step that ends within the plan: of the first states, in order.
    """
    times = episode.times
    whole = np.count_nonzero(times + duration <= times[-1] + TIME_TOLERANCE * duration)
    ends = np.minimum(times[:whole] + duration, times[-1])
    integral = np.zeros((len(times), episode.controls.shape[1]))
    np.cumsum(episode.controls * np.diff(times)[:, None], axis=0, out=integral[1:])
    after = [np.interp(ends, times, column) for column in integral.T]
    return (np.stack(after, axis=1) - integral[:whole]) / duration


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


def _check_replay(config: TrainConfig, observer: Observer, task: Task, demos: Demos) -> None:
    """Check that transitions along plans can be computed.

    Raises:
        UsageError: they cannot.
    """
    num_controls = task.compile()[0].nu
    if not demos.controls.any():
        raise UsageError("--replay needs the controls of the plans, but they have none: use --resets.")
    if demos.info.num_controls != num_controls:
        raise UsageError(
            f"--replay needs plans with the {num_controls} controls of {task.name}, but these have "
            f"{demos.info.num_controls}: use --resets."
        )
    if config.shaping != "none":
        raise UsageError("--replay has no shaping rewards: leave out --shaping, or use --resets.")
    if len(observer.embeddings) > 1:
        raise UsageError(
            f"--replay needs one embedding for all seeds, got {len(observer.embeddings)}: use --resets."
        )
