"""DeepMind Control's cart-pole: balance one pole, or swing up one to three poles in a row.

States are the cart's position [m], the angle of each pole relative to the one below [rad], and their
velocities [m/s, rad/s]; the poles are up at 0.
"""

import copy
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Bool, Float

from planspace.tasks.dm_control.suite import DMC_PREFIX, HORIZON, read_suite, suite_model
from planspace.tasks.dm_control.tolerance import small, within
from planspace.tasks.problem import Box, Problem
from planspace.tasks.task import Task

MAX_CART = 0.25
"""The sparse reward needs the cart within plus and minus this [m]."""
MIN_COSINE = 0.995
"""The sparse reward needs the cosine of each pole's angle from the vertical to be at least this."""
SLIDER_STD, FIRST_STD, OTHER_STD, VELOCITY_STD = 0.01, 0.01, 0.1, 0.01
"""Standard deviations of the first states of a swing-up around hanging poles [m, rad, rad, m/s or rad/s]."""
BALANCE = (0.1, 0.034)
"""When balancing, the cart starts within plus and minus 0.1 m, and the pole within 0.034 rad."""


@dataclass(frozen=True)
class CartPole:
    """Starts and rewards of one task."""

    num_poles: int
    swing_up: bool
    """Whether the poles hang at first; otherwise they are nearly upright."""

    def draw_starts(self, num: int, rng: np.random.Generator) -> Float[np.ndarray, "env state"]:
        """Draw the first states."""
        poles = self.num_poles
        if self.swing_up:
            std = np.array([SLIDER_STD, FIRST_STD, *[OTHER_STD] * (poles - 1)])
            positions = np.array([0.0, np.pi, *[0.0] * (poles - 1)]) + std * rng.standard_normal(
                (num, 1 + poles)
            )
        else:
            limit = np.array([BALANCE[0], *[BALANCE[1]] * poles])
            positions = rng.uniform(-limit, limit, (num, 1 + poles))
        return np.concatenate([positions, VELOCITY_STD * rng.standard_normal((num, 1 + poles))], axis=1)

    def angles(self, states: np.ndarray) -> Float[np.ndarray, "env pole"]:
        """Return the angle of each pole from the vertical [rad]."""
        return np.cumsum(states[:, 1 : 1 + self.num_poles], axis=1)

    def reward(
        self, before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        """Return the product of how upright, centred, effortless and slow the cart-pole is."""
        upright = (1.0 + np.cos(self.angles(after)).mean(axis=1)) / 2.0
        centred = (1.0 + within(after[:, 0], 0.0, 0.0, margin=2.0)) / 2.0
        effortless = (4.0 + small(control[:, 0])) / 5.0
        slow = (1.0 + within(after[:, 2 + self.num_poles :], 0.0, 0.0, margin=5.0).min(axis=1)) / 2.0
        return upright * centred * effortless * slow

    def sparse_reward(
        self, before: np.ndarray, after: np.ndarray, control: np.ndarray, target: np.ndarray
    ) -> Float[np.ndarray, " env"]:
        """Return 1 if the cart is in the middle and every pole is upright, else 0."""
        return self.at_goal(after, target).astype(float)

    def at_goal(self, states: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " env"]:
        """Return whether the sparse reward is 1."""
        upright = (np.cos(self.angles(states)) >= MIN_COSINE).all(axis=1)
        return np.asarray((np.abs(states[:, 0]) <= MAX_CART) & upright)

    def observe(self, states: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "env obs"]:
        """Observe the cart's position, the cosine and sine of each pole's angle, and the velocities."""
        angles = self.angles(states)
        poles = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(states), -1)
        return np.concatenate([states[:, :1], poles, states[:, 1 + self.num_poles :]], axis=1)


def model_text(num_poles: int) -> str:
    """Return dm_control's cart-pole with as many poles, each on top of the one before."""
    root = ElementTree.fromstring(read_suite("cartpole"))
    pole = root.find(".//body[@name='pole_1']")
    assert pole is not None
    first = copy.deepcopy(pole)
    for i in range(2, 1 + num_poles):
        upper = copy.deepcopy(first)
        upper.attrib |= {"name": f"pole_{i}", "pos": "0 0 1"}
        for part in upper:
            part.set("name", part.get("name", "").replace("_1", f"_{i}"))
        pole.append(upper)
        pole = upper
    floor = root.find("./worldbody/geom[@name='floor']")
    if num_poles > 1 and floor is not None:
        floor.set("pos", f"0 0 {0.95 - num_poles}")  # hanging poles stay above it
    return ElementTree.tostring(root, encoding="unicode")


def make_tasks() -> list[Task]:
    """Make the tasks with one pole, and `cartpole-two-poles` and `cartpole-three-poles`."""
    one = make_problem(1, (4.0, 12.0))
    return [
        make_task("balance", one, CartPole(1, swing_up=False)),
        make_task("balance-sparse", one, CartPole(1, swing_up=False), sparse=True),
        make_task("swingup", one, CartPole(1, swing_up=True)),
        make_task("swingup-sparse", one, CartPole(1, swing_up=True), sparse=True),
        make_task("two-poles", make_problem(2, (4.0, 10.0, 12.0)), CartPole(2, swing_up=True)),
        make_task("three-poles", make_problem(3, (4.0, 10.0, 12.0, 12.0)), CartPole(3, swing_up=True)),
    ]


def make_problem(num_poles: int, sample_velocity: tuple[float, ...]) -> Problem:
    """Make the planning problem of the swing-up of as many poles.

    Args:
        num_poles: the number of poles.
        sample_velocity: the fastest velocities of exploration [m/s, rad/s].
    """
    poles = num_poles - 1
    hanging = np.array([0.0, np.pi, *[0.0] * (poles + 2 + poles)])
    std = np.array([SLIDER_STD, FIRST_STD, *[OTHER_STD] * poles, *[VELOCITY_STD] * (2 + poles)])
    names = {1: "dmc-cartpole", 2: "dmc-two-poles"}
    return Problem(
        name=names.get(num_poles, f"dmc-cartpole-{num_poles}-poles"),
        model=suite_model(model_text(num_poles)),
        joints=("slider", *(f"hinge_{i}" for i in range(1, 1 + num_poles))),
        start=Box(tuple((hanging - 3 * std).tolist()), tuple((hanging + 3 * std).tolist())),
        goal=Box((0.0,) * len(hanging), (0.0,) * len(hanging)),
        tolerance=0.1,
        sample_velocity=sample_velocity,
    )


def make_task(name: str, problem: Problem, functions: CartPole, *, sparse: bool = False) -> Task:
    """Make a task.

    Args:
        name: its name in the domain, such as `swingup`.
        problem: its planning problem.
        functions: its starts, observations and rewards.
        sparse: whether it pays the sparse reward.
    """
    poles = range(1, 1 + functions.num_poles)
    limit = (BALANCE[0], *[BALANCE[1]] * len(poles), *[3 * VELOCITY_STD] * (1 + len(poles)))
    swing_up = functions.swing_up
    return Task(
        name=f"{DMC_PREFIX}cartpole-{name}",
        model=problem.source,
        joints=problem.joints,
        start_low=problem.start.low if swing_up else tuple(-x for x in limit),
        start_high=problem.start.high if swing_up else limit,
        horizon=HORIZON,
        reward=functions.sparse_reward if sparse else functions.reward,
        at_goal=functions.at_goal,
        observe=functions.observe,
        obs_fields=(
            ("slider", "m"),
            *((f"{part}_{pole}", "") for pole in poles for part in ("cos", "sin")),
            ("slidervel", "m/s"),
            *((f"hinge_{pole}vel", "rad/s") for pole in poles),
        ),
        trig_columns=(),
        draw_starts=functions.draw_starts,
        problem=problem,
    )
