"""Episodes under a controller."""

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from planspace.control.controller import Controller
from planspace.embed.pixels.sight import Sight
from planspace.physics.simulator import Simulator
from planspace.plan.state_filter import StateFilter
from planspace.tasks.task import Task

LAST_S = 1.0
"""An episode succeeds if every state of the last second is at the goal [s]."""


@dataclass(frozen=True)
class ControlledEpisode:
    """One episode under a controller."""

    states: Float[np.ndarray, "time state"]
    """The state at the start and after each control step."""
    controls: Float[np.ndarray, "step control"]
    """What was applied."""
    rewards: Float[np.ndarray, " step"]
    """Rewards of the task."""
    at_goal: Bool[np.ndarray, " time"]
    """Whether each state is at the goal, as the task judges it."""
    regulated: Bool[np.ndarray, " step"]
    """Whether the regulator at the goal gave the control."""
    followed: Bool[np.ndarray, " step"]
    """Whether the control follows a plan."""
    seconds: Float[np.ndarray, " step"]
    """Wall time for which each control was computed [s]."""
    goal: Float[np.ndarray, " state"]
    """The centre of the goal region."""
    step: float
    """Time between two states [s]."""

    @property
    def success(self) -> bool:
        """Whether every state of the last second is at the goal."""
        last = max(1, round(LAST_S / self.step))
        return len(self.at_goal) > last and bool(self.at_goal[-last - 1 :].all())

    @property
    def arrival(self) -> int | None:
        """Index of the state from which on the episode stays at the goal; None if it does not end there."""
        if not self.at_goal[-1]:
            return None
        away = np.flatnonzero(~self.at_goal)
        return int(away[-1]) + 1 if len(away) else 0


def run_episode(
    controller: Controller,
    seed: int,
    index: int,
    num_steps: int | None = None,
    sight: Sight | None = None,
    start: Float[np.ndarray, " state"] | None = None,
) -> ControlledEpisode:
    """Run one episode from a start of the task, or from a given state.

    The episode depends on the controller, the seed and the index only. It ends early where the task ends or
    physics diverges.

    Args:
        controller: acts; it is reset.
        seed: seed of starts, goals and samples.
        index: number of the episode.
        num_steps: control steps; by default the task's horizon.
        sight: estimates the state from pictures; the controller sees the estimates, filtered if their errors
            are known. None shows it the true state.
        start: where the episode starts instead.
    """
    plant = controller.plant
    task = plant.task
    starts, targets = task.sample_starts(1, np.random.default_rng((seed, index)))
    if start is not None:
        starts = np.asarray(start, dtype=float)[None]
    controller.reset((seed, index, 1), targets[0])
    if sight is not None:
        error, motion = sight.state_error, (plant.model, plant.space, plant.physics_steps)
        state_filter = None if error is None else StateFilter(*motion, error)
        sight.restart(np.random.default_rng((seed, index, 2)), state_filter)
    simulator = plant.simulator(1)
    simulator.reset(starts)
    states, controls, rewards, regulated, followed, seconds = [starts[0]], [], [], [], [], []
    for _ in range(num_steps or task.horizon):
        began = time.perf_counter()
        control = controller(states[-1] if sight is None else sight.see(states[-1])[1])
        if sight is not None:
            sight.applied(control)
        seconds.append(time.perf_counter() - began)
        after, reward, terminated = _hold(simulator, task, states[-1], control, targets)
        if simulator.diverged()[0]:
            seconds.pop()
            break
        rewards.append(reward)
        regulated.append(controller.regulated)
        followed.append(controller.followed)
        controls.append(control)
        states.append(after)
        if terminated:
            break
    path = np.stack(states)
    return ControlledEpisode(
        states=path,
        controls=np.array(controls).reshape(-1, len(simulator.control_low)),
        rewards=np.array(rewards, dtype=float),
        at_goal=plant.at_goal(path, targets[0]),
        regulated=np.array(regulated, dtype=bool),
        followed=np.array(followed, dtype=bool),
        seconds=np.array(seconds),
        goal=plant.goal(targets[0]).center,
        step=plant.control_step,
    )


def _hold(
    simulator: Simulator,
    task: Task,
    before: Float[np.ndarray, " state"],
    control: Float[np.ndarray, " control"],
    targets: Float[np.ndarray, "1 target"],
) -> tuple[Float[np.ndarray, " state"], float, bool]:
    """Hold a control for one control step: the state after it, the rewards, and whether the task ended."""
    total, now = 0.0, before[None]
    for _ in range(task.action_repeat):
        simulator.step(control[None], task.frame_skip)
        after = simulator.states()
        total += float(task.reward(now, after, control[None], targets)[0])
        if task.terminated(after)[0]:
            return after[0], total, True
        now = after
    return now[0], total, False
