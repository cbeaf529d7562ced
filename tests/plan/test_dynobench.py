"""The models that `benchmarks/dynobench.py` writes move as the equations of dynobench say.

The equations are written down here once more, from the Lagrangian of each system, in NumPy.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem

ROOT = Path(__file__).parents[2]
FOLDER = ROOT.parent / "shared" / "data" / "dynobench"
G = 9.81
SAME = 1e-9
"""Largest difference between two accelerations, absolute and relative."""
NUM_STATES = 100

pytestmark = pytest.mark.skipif(not FOLDER.exists(), reason="dynobench is not beside this checkout")


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Problem]:
    monkeypatch.setattr(sys, "path", [str(ROOT / "benchmarks"), *sys.path])
    from dynobench import load_dynobench

    return lambda name: load_problem(load_dynobench(FOLDER, name))


def parameters(system: str) -> dict[str, Any]:
    content = yaml.safe_load((FOLDER / f"{system}.model.yaml").read_text())
    return {
        key: float(value)
        for key, value in content.items()
        if not isinstance(value, list | bool) and key not in ("dynamics", "shape")
    }


def acrobot(p: dict[str, float], q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """M(q) a + C(q, v) + G(q) = (0, u), with the inertias I1 and I2 about the pivots."""
    c2, s2, coupling = np.cos(q[1]), np.sin(q[1]), p["m2"] * p["l1"] * p["lc2"]
    m11 = p["I1"] + p["I2"] + p["m2"] * p["l1"] ** 2 + 2 * coupling * c2
    m12 = p["I2"] + coupling * c2
    first = G * (p["m1"] * p["lc1"] + p["m2"] * p["l1"]) * np.sin(q[0])
    second = G * p["m2"] * p["lc2"] * np.sin(q[0] + q[1])
    coriolis = coupling * s2 * np.array([-(2 * v[0] * v[1] + v[1] ** 2), v[0] ** 2])
    right = np.array([0.0, u[0]]) - coriolis - np.array([first + second, second])
    return np.linalg.solve(np.array([[m11, m12], [m12, p["I2"]]]), right)


def quadrotor(p: dict[str, float], q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """m (x, y)'' = (f1 + f2) (-sin, cos)(theta) - (0, m g),  I theta'' = l (f1 - f2),  f = u m g / 2."""
    f1, f2 = 0.5 * p["m"] * G * u
    x, y = (f1 + f2) / p["m"] * np.array([-np.sin(q[2]), np.cos(q[2])])
    return np.array([x, y - G, p["l"] * (f1 - f2) / p["I"]])


def quadrotor_with_pole(p: dict[str, float], q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The same with a mass m_p at (x, y) + r (sin, -cos)(theta + q)."""
    f1, f2 = 0.5 * p["m"] * G * u
    s, c, rate = np.sin(q[2] + q[3]), np.cos(q[2] + q[3]), v[2] + v[3]
    m, m_p, r = p["m"], p["m_p"], p["r"]
    turning = m_p * r**2
    mass = np.array(
        [
            [m + m_p, 0, m_p * r * c, m_p * r * c],
            [0, m + m_p, m_p * r * s, m_p * r * s],
            [m_p * r * c, m_p * r * s, p["I"] + turning, turning],
            [m_p * r * c, m_p * r * s, turning, turning],
        ]
    )
    thrust = (f1 + f2) * np.array([-np.sin(q[2]), np.cos(q[2])])
    swing = m_p * r * rate**2 * np.array([-s, c])
    x, y = thrust - swing - [0, (m + m_p) * G]
    weight = -m_p * G * r * s
    return np.linalg.solve(mass, [x, y, p["l"] * (f1 - f2) + weight, weight])


@pytest.mark.parametrize(
    ("name", "equations"),
    [
        ("acrobot_v0.swing_up_empty", acrobot),
        ("quad2d_v0.empty_0", quadrotor),
        ("quad2dpole_v0.down", quadrotor_with_pole),
    ],
)
def test_accelerations_are_those_of_the_equations(
    load: Callable[[str], Problem], name: str, equations: Callable[..., np.ndarray]
) -> None:
    problem, rng = load(name), np.random.default_rng(0)
    model, space = problem.compile()
    data, known = mujoco.MjData(model), parameters(name.partition(".")[0])
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 and model.opt.timestep == 0.01
    states = space.sample(rng, NUM_STATES, space.velocity_bound)
    controls = rng.uniform(*model.actuator_ctrlrange.T, (NUM_STATES, model.nu))
    for state, control in zip(states, controls, strict=True):
        space.write(state, data.qpos, data.qvel)
        data.ctrl[:] = control
        mujoco.mj_forward(model, data)
        wanted = equations(known, *np.split(state, 2), control)
        np.testing.assert_allclose(data.qacc, wanted, rtol=SAME, atol=SAME)


def test_rods_collide_where_they_do_in_dynobench(load: Callable[[str], Problem]) -> None:
    model, space = load("quad2dpole_v0.window").compile()
    data, r = mujoco.MjData(model), 1.0
    for x, y, theta, q, *_ in space.sample(np.random.default_rng(1), 20, space.velocity_bound):
        space.write(np.array([x, y, theta, q, 0, 0, 0, 0]), data.qpos, data.qvel)
        mujoco.mj_kinematics(model, data)
        wanted = [x + 0.5 * r * np.sin(theta + q), y - 0.5 * r * np.cos(theta + q), 0.0]
        np.testing.assert_allclose(data.geom("pole").xpos, wanted, atol=1e-12)
        np.testing.assert_allclose(data.geom("frame").xpos, [x, y, 0.0], atol=1e-12)


def test_a_state_beside_an_obstacle_is_valid_and_one_in_it_is_not(load: Callable[[str], Problem]) -> None:
    """The column of `quad_obs_column` ends at x = 2.8, y = 3; the quadrotor is 0.6 m by 0.2 m."""
    from planspace.physics.simulator import Simulator

    problem = load("quad2d_v0.quad_obs_column")
    simulator = Simulator(*problem.compile(), 4, threads=1, validity=problem.validity)
    states = np.zeros((4, 6))
    states[:, :2] = [(2.49, 2.0), (2.51, 2.0), (3.0, 3.11), (3.0, 3.09)]
    assert simulator.valid_states(states).tolist() == [True, False, True, False]


def test_every_problem_of_the_folder_is_read(load: Callable[[str], Problem]) -> None:
    from dynobench import problem_names

    names = problem_names(FOLDER)
    assert len(names) == 20
    for name in names:
        problem = load(name)
        assert (problem.tolerance, problem.hold) == (0.03, False)
        assert (problem.forbidden_contacts == "all") == ("obstacle" in problem.source.text)
