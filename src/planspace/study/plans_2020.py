"""Demonstrations as wrong as those of 2020, to learn what such demonstrations are worth.

The planner of 2020 did not bring angles to the circle before it measured how far apart they are: beyond a
turn the distance fell below zero, so that winding the pole up counted as coming near. Its controls were
within +-1 of the +-3 there are; a plan was done when the sum of differences was at most 0.1.

Here such plans come from random shooting: of some random pushes those are begun whose pole has most energy
and has turned farthest, until that measure says it has arrived: pole wound up, nothing near the goal. They
end where the released ones do, at angles near +-11 and speeds near 3, after some 230 steps.
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
"""Physics steps a control is held; in 2020 1 to 10."""
PUSHES, AHEAD = 64, 8
"""Sequences that are tried, and controls of each."""
KEPT = 0.8
"""Half of the sequences are the best one so far, each control with this probability."""
GRAVITY = 23.4
"""m g l / I of the pole about its hinge [1/s^2]: its energy over its inertia is thetadot^2 / 2 + this times
its height, 1 + cos theta."""
ENOUGH = 60.0
"""Energy over inertia beyond which more is not sought; 46.8 is a pole at rest on top [1/s^2]."""
A_RADIAN = 5.0
"""What a radian it has turned is worth in these units."""
MAX_STEPS = 400
TURN = 2 * np.pi


def wound_plans(problem: Problem, out: Path, num: int, seed: int) -> DemoFolder:
    """Makes such demonstrations; the same call continues an interrupted one.

    Args:
        problem: the swing-up.
        out: the dataset's folder.
        num: how many.
        seed: of all of them.
    """
    if problem.name != PROBLEM:
        raise PlanspaceError(f"poles are wound up in {PROBLEM} alone, not in {problem.name}.")
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
    """Sum of absolute differences, the angle's falling again beyond half a turn, without end."""
    apart = np.abs(state - goal)
    apart[ANGLE] = min(apart[ANGLE], TURN - apart[ANGLE])
    return np.asarray(apart.sum())


def _plan(problem: Problem, simulator: Simulator, index: int, rng: np.random.Generator) -> Episode:
    goal = np.array(problem.goal.low)
    states, controls, best = [problem.draw_start(simulator, rng)], [], np.empty((0, 1))
    while distance_of_2020(states[-1], goal) > problem.tolerance:
        if len(controls) >= MAX_STEPS:  # it got nowhere: from another start
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
