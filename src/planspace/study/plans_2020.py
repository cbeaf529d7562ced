"""Demonstrations with the errors of those of 2020, to measure what such demonstrations are worth.

The planner of 2020 did not wrap angles to the circle before it measured distances. Beyond one rotation the
distance became negative, so winding the pole up looked like progress. Its controls were within +-1, although
+-3 are allowed. A plan was finished when the sum of absolute differences was at most 0.1.

This module makes such plans by random shooting: among random pushes it begins the ones whose pole has the
most energy and has rotated farthest, until the measure of 2020 says that the goal is reached. The pole is
then wound up, and the state is far from the goal. Like the released plans, these end at angles near +-11 and
speeds near 3, after about 230 steps.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from planspace.demos.episode import Episode
from planspace.demos.folder import DemoFolder
from planspace.demos.manifest import DatasetSettings
from planspace.errors import PlanspaceError
from planspace.physics.simulator import Simulator
from planspace.plan.demonstrations import SHARD_EPISODES, state_info
from planspace.progress import progress
from planspace.tasks.problem import Problem

PROBLEM = "cartpole-swingup"
"""Whose states are (x, theta, xdot, thetadot)."""
ANGLE, SPEED = 1, 3
HOLD = 5
"""Physics steps for which a control is held; 1 to 10 in 2020."""
PUSHES, AHEAD = 64, 8
"""Number of sequences that are tried, and number of controls in each."""
KEPT = 0.8
"""Half of the sequences copy each control of the best sequence so far with this probability."""
GRAVITY = 23.4
"""m g l / I of the pole about its hinge [1/s^2]: its energy over its inertia is thetadot^2 / 2 + this times
its height, 1 + cos theta."""
ENOUGH = 60.0
"""Energy over inertia that is enough; a pole at rest on top has 46.8 [1/s^2]."""
A_RADIAN = 5.0
"""Value of one radian of rotation in these units."""
MAX_STEPS = 400
ROTATION = 2 * np.pi


def winding_plans(problem: Problem, out: Path, num: int, seed: int) -> DemoFolder:
    """Make plans with winding; the same call continues an interrupted one.

    Args:
        problem: the swing-up.
        out: the dataset's folder.
        num: number of plans.
        seed: seed of all plans.
    """
    if problem.name != PROBLEM:
        raise PlanspaceError(f"plans with winding exist only for {PROBLEM}, got {problem.name}.")
    model, space = problem.compile()
    simulator = Simulator(model, space, PUSHES, threads=1)
    settings = DatasetSettings(problem=problem.hash, planner="wound up as in 2020", seed=seed)
    folder = DemoFolder(out, state_info(problem), settings)
    batch: list[Episode] = []
    with progress("plan", num, done=folder.next_index, unit="plan") as bar:
        for i in range(folder.next_index, num):
            batch.append(_plan(problem, simulator, i, np.random.default_rng([seed, i])))
            bar.update()
            if len(batch) == SHARD_EPISODES or i + 1 == num:
                folder.append(batch, i + 1)
                batch = []
    return folder


def distance_of_2020(
    state: Float[np.ndarray, " state"], goal: Float[np.ndarray, " state"]
) -> Float[np.ndarray, ""]:
    """Sum of absolute differences; that of the angle falls without end beyond half a rotation."""
    apart = np.abs(state - goal)
    apart[ANGLE] = min(apart[ANGLE], ROTATION - apart[ANGLE])
    return np.asarray(apart.sum())


def _plan(problem: Problem, simulator: Simulator, index: int, rng: np.random.Generator) -> Episode:
    goal = np.array(problem.goal.low)
    states, controls, best = [problem.draw_start(simulator, rng)], [], np.empty((0, 1))
    while distance_of_2020(states[-1], goal) > problem.tolerance:
        if len(controls) >= MAX_STEPS:  # no progress: try another start
            states, controls, best = [problem.draw_start(simulator, rng)], [], np.empty((0, 1))
        pushes = rng.uniform(-1.0, 1.0, (AHEAD, PUSHES, 1))
        near = pushes[: len(best), : PUSHES // 2]
        near[:] = np.where(rng.random(near.shape) < KEPT, best[:, None], near)
        ends = np.repeat(states[-1][None], PUSHES, axis=0)
        for push in pushes:
            ends, _ = simulator.propagate(ends, push, np.full(PUSHES, HOLD))
        first, *best = pushes[:, _promise(ends).argmax()]
        simulator.reset(np.repeat(states[-1][None], PUSHES, axis=0))
        for _ in range(HOLD):
            simulator.step(np.repeat(first[None], PUSHES, axis=0), 1)
            states.append(simulator.states()[0].copy())
            controls.append(first)
            if distance_of_2020(states[-1], goal) <= problem.tolerance:
                break
        best = np.array(best)
    times = simulator.model.opt.timestep * np.arange(len(states))
    return Episode(np.stack(states), np.stack(controls), times, goal, False, index, 0)


def _promise(states: Float[np.ndarray, "push state"]) -> Float[np.ndarray, " push"]:
    theta, speed = states[:, ANGLE], states[:, SPEED]
    energy = 0.5 * speed**2 + GRAVITY * (1.0 + np.cos(theta))
    return np.minimum(energy, ENOUGH) + A_RADIAN * np.abs(theta)
