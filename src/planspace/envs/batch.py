"""Many episodes of one task, stepped together; all environments of planspace use this."""

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.physics.simulator import Simulator
from planspace.tasks.check_task import check_task
from planspace.tasks.observation_types import RewardType
from planspace.tasks.task import Task


class TaskBatch:
    """`num` episodes of a task in one batch of simulations."""

    def __init__(self, task: Task, num: int, *, threads: int = 0, reward: RewardType = "dense"):
        """Start the simulations; `reset` starts the episodes.

        Args:
            task: the task; one that does not fit its model is refused (see `check_task`).
            num: number of episodes.
            threads: physics threads; 0 uses all CPUs. Results do not depend on it.
            reward: the reward type. With `2020`, controls have no limits, as in the 2020 code.
        """
        model, space = task.compile()
        check_task(task, model, space)
        if reward == "2020":
            model.actuator_ctrllimited[:] = False
        self.task = task
        self.reward: RewardType = reward
        self.simulator = Simulator(model, space, num, threads=threads)
        self.states = np.zeros((num, space.size))
        """The state of each episode [env, state]."""
        self.targets = np.zeros((num, task.target_size))
        """The target of each episode [env, target]; no columns for a task without targets."""

    def reset(
        self,
        states: Float[np.ndarray, "env state"],
        targets: Float[np.ndarray, "env target"],
        ids: Int[np.ndarray, " env"] | None = None,
    ) -> None:
        """Start episodes (all, or those in `ids`) at the given states with the given targets."""
        index = slice(None) if ids is None else ids
        self.simulator.reset(states, ids)
        self.states[index], self.targets[index] = states, targets

    def step(
        self, actions: Float[np.ndarray, "env control"]
    ) -> tuple[Float[np.ndarray, " env"], Bool[np.ndarray, " env"], Bool[np.ndarray, " env"]]:
        """Take one step in every episode, or hold the action for as many steps as the task says.

        An episode whose physics diverge keeps the state before the step and earns 0; the caller ends it.

        Returns:
            The rewards, whether each episode terminated, and whether its physics diverged.
        """
        simulator = self.simulator
        applied = np.clip(actions, simulator.control_low, simulator.control_high)
        reward, terminated, diverged = self._step(applied)
        for _ in range(1, self.task.action_repeat):
            ended, last = terminated | diverged, self.states
            more, now_terminated, now_diverged = self._step(applied)
            self.states = np.where(ended[:, None], last, self.states)  # an episode that ended stays there
            reward = reward + np.where(ended, 0.0, more)
            terminated, diverged = terminated | now_terminated & ~ended, diverged | now_diverged & ~ended
        return reward, terminated, diverged

    def _step(
        self, applied: Float[np.ndarray, "env control"]
    ) -> tuple[Float[np.ndarray, " env"], Bool[np.ndarray, " env"], Bool[np.ndarray, " env"]]:
        """Take one step of the task with controls within their limits."""
        before, simulator = self.states, self.simulator
        simulator.step(applied, self.task.frame_skip)
        diverged = simulator.diverged()
        after = np.where(diverged[:, None], before, simulator.states())
        reward = self.task.reward_as(self.reward, before, after, applied, self.targets)
        self.states = after
        return np.where(diverged, 0.0, reward), self.task.terminated(after), diverged

    def mujoco_data(self, episode: int) -> mujoco.MjData:
        """Return the current state of an episode for drawing, with its target in place."""
        data = self.simulator.mujoco_data(episode)
        size = min(self.task.target_size, 3)
        if size and self.simulator.model.nmocap:
            data.mocap_pos[0, :size] = self.targets[episode, :size]
            mujoco.mj_forward(self.simulator.model, data)
        return data
