"""A task that draws goals, and plans of it that need no planner."""

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.physics.simulator import Simulator
from planspace.tasks.catalog import find_task
from planspace.tasks.task import Task


def reaches() -> tuple[Task, Demos]:
    """A task that draws goals, and three plans of it; the goal of the second one is not known."""
    task = find_task("reacher-random")
    assert isinstance(task, Task)
    model, space = task.compile()
    simulator = Simulator(model, space, 3, threads=1)
    states = [np.zeros((3, 4))]
    simulator.reset(states[0])
    controls = np.array([[0.5, 0.0], [-0.5, 0.2], [0.0, -0.3]])
    for _ in range(5):
        simulator.step(controls, task.frame_skip)
        states.append(simulator.states())
    times = task.frame_skip * model.opt.timestep * np.arange(6)
    goals = [np.array([0.3, 0.1, 0.0, 0.0]), np.full(4, np.nan), np.array([0.1, -0.2, 0.0, 0.0])]
    episodes = [
        Episode(np.stack(states)[:, i], np.tile(controls[i], (5, 1)), times, goals[i], False, i, 0)
        for i in range(3)
    ]
    info = StateInfo.of_model(model, space, problem=task.name, joints=task.joints, source=task.source)
    return task, Demos.from_episodes(info, episodes)
