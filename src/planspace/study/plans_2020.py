"""Demonstrations with the errors of the 2020 planner, to measure how well embeddings learn from them.

The planner of 2020 did not wrap angles to the circle before it measured distances. Beyond one rotation the
distance became negative, so winding the pole up looked like progress. Its controls were within +-1, although
+-3 are allowed. A plan was finished when the sum of absolute differences was at most 0.1.

This module makes such plans by random shooting. Of many random control sequences, it applies the start of the
one whose pole gains the most energy and rotates farthest, until the distance of 2020 says that the goal is
reached. The pole has then rotated several times, and the state is far from the goal. Like the released plans,
these end at angles near +-11 rad and speeds near 3 rad/s, after about 230 steps.
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
"""Its states are (x, theta, xdot, thetadot)."""
ANGLE, SPEED = 1, 3
"""Indices of theta and thetadot."""
HOLD = 5
"""Physics steps for which a control is held; 1 to 10 in 2020."""
SEQUENCES, LENGTH = 64, 8
"""Number of control sequences that are tried, and number of controls in each."""
COPY_PROBABILITY = 0.8
"""Half of the sequences copy each control of the best sequence so far with this probability."""
GRAVITY = 23.4
"""m g l / I of the pole about its hinge [1/s^2]. The pole's energy divided by its inertia is thetadot^2 / 2 +
this * (1 + cos theta)."""
MAX_ENERGY = 60.0
"""Energy divided by inertia beyond which more energy adds no value [1/s^2]. An upright pole has 46.8."""
VALUE_PER_RADIAN = 5.0
"""Value of one radian of rotation [1/s^2]."""
MAX_STEPS = 400
"""Number of controls after which planning starts again from another state."""
ROTATION = 2 * np.pi


def winding_plans(problem: Problem, out: Path, num: int, seed: int) -> DemoFolder:
    """Make plans with winding. The same call resumes an interrupted one.

    Args:
        problem: the problem `cartpole-swingup`.
        out: the dataset's folder.
        num: number of plans.
        seed: seed of all plans.

    Raises:
        PlanspaceError: the problem is not `cartpole-swingup`.
    """
    if problem.name != PROBLEM:
        raise PlanspaceError(f"plans with winding exist only for {PROBLEM}, got {problem.name}.")
    model, space = problem.compile()
    simulator = Simulator(model, space, SEQUENCES, threads=1)
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
    """Sum of absolute differences, as in 2020: beyond one rotation, the angle's difference is negative."""
    difference = np.abs(state - goal)
    difference[ANGLE] = min(difference[ANGLE], ROTATION - difference[ANGLE])
    return np.asarray(difference.sum())


def _plan(problem: Problem, simulator: Simulator, index: int, rng: np.random.Generator) -> Episode:
    goal = np.array(problem.goal.low)
    states, controls, best = [problem.draw_start(simulator, rng)], [], np.empty((0, 1))
    while distance_of_2020(states[-1], goal) > problem.tolerance:
        if len(controls) >= MAX_STEPS:  # start again
            states, controls, best = [problem.draw_start(simulator, rng)], [], np.empty((0, 1))
        sequences = rng.uniform(-1.0, 1.0, (LENGTH, SEQUENCES, 1))
        copies = sequences[: len(best), : SEQUENCES // 2]
        copies[:] = np.where(rng.random(copies.shape) < COPY_PROBABILITY, best[:, None], copies)
        ends = np.repeat(states[-1][None], SEQUENCES, axis=0)
        for control in sequences:
            ends, _ = simulator.propagate(ends, control, np.full(SEQUENCES, HOLD))
        first, *best = sequences[:, _value(ends).argmax()]
        simulator.reset(np.repeat(states[-1][None], SEQUENCES, axis=0))
        for _ in range(HOLD):
            simulator.step(np.repeat(first[None], SEQUENCES, axis=0), 1)
            states.append(simulator.states()[0].copy())
            controls.append(first)
            if distance_of_2020(states[-1], goal) <= problem.tolerance:
                break
        best = np.array(best)
    times = simulator.model.opt.timestep * np.arange(len(states))
    return Episode(np.stack(states), np.stack(controls), times, goal, False, index, 0)


def _value(states: Float[np.ndarray, "sequence state"]) -> Float[np.ndarray, " sequence"]:
    """Value of the final state of each sequence."""
    theta, speed = states[:, ANGLE], states[:, SPEED]
    energy = 0.5 * speed**2 + GRAVITY * (1.0 + np.cos(theta))
    return np.minimum(energy, MAX_ENERGY) + VALUE_PER_RADIAN * np.abs(theta)
