"""Shortest durations, with which plans and embeddings are compared.

    python benchmarks/ground_truth.py     writes benchmarks/ground_truth/*.npz; about 5 minutes on two cores

- Pendulum: the time to the goal region from every state of a grid, by value iteration.
- Reacher: each joint is a damped double integrator to within 0.1 %, so the time to its goal is known in
  closed form.
- Cart-pole: no formula exists. The best known duration is the shortest of 20 polished plans from each of
  60 starts.
"""

import io
import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq

from planspace.demos.load import load_demos
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.storage.files import write_bytes
from planspace.tasks.problem_file import load_problem

FOLDER = Path(__file__).parent / "ground_truth"

PENDULUM_INERTIA, PENDULUM_GRAVITY, PENDULUM_DAMPING, PENDULUM_TORQUE = 1 / 3, 9.81 * 0.5, 0.05, 2.0
PENDULUM_SPEED = 9.0
"""Largest angular velocity of the grid [rad/s]; plans that start hanging stay far below it."""
TOLERANCE = 0.1

REACHER_INERTIA, REACHER_DAMPING, REACHER_TORQUE = 1.0 + 7e-4, 1.0, 200.0
"""Armature 1 and the links' own 7e-4 kg m^2; gear 200 times control 1."""

TRUTH_STARTS = 500
BEST_KNOWN_STARTS, BEST_KNOWN_TRIES = 60, 20


def pendulum_grid(angles: int = 801, speeds: int = 901, dt: float = 0.02) -> tuple[np.ndarray, ...]:
    """Value iteration: V(x) = 0 in the goal region, else min over u in {-2, 0, 2} of dt + V(x after dt).

    The shortest way is bang-bang, so three torques do. V is interpolated linearly between grid points;
    sweeps end when no value changes by more than 1e-5 s.

    Returns:
        Angles, speeds, and the time to go [s] on their grid.
    """
    theta, omega = np.linspace(-np.pi, np.pi, angles), np.linspace(-PENDULUM_SPEED, PENDULUM_SPEED, speeds)
    x, v = np.meshgrid(theta, omega, indexing="ij")
    inside = np.abs(x) + np.abs(v) <= TOLERANCE
    successors = []
    for torque in (-PENDULUM_TORQUE, 0.0, PENDULUM_TORQUE):
        a, b = _pendulum_step(x, v, torque, dt)
        successors.append(_cells(a, b, theta, omega))
    value = np.where(inside, 0.0, 20.0)
    while True:
        best = np.minimum.reduce([_interpolate(value, cells) for cells in successors])
        fresh = np.where(inside, 0.0, np.minimum(dt + best, 20.0))
        change = np.abs(fresh - value).max()
        value = fresh
        if change < 1e-5:
            return theta, omega, value


def pendulum_time(states: Float[np.ndarray, "start state"]) -> Float[np.ndarray, " start"]:
    """Time to the goal [s] from each state (theta, thetadot)."""
    with np.load(FOLDER / "pendulum.npz") as grid:
        interpolate = RegularGridInterpolator((grid["theta"], grid["omega"]), grid["time"].astype(float))
    wrapped = np.pi - np.mod(np.pi - states[:, 0], 2 * np.pi)
    return interpolate(np.stack([wrapped, states[:, 1]], axis=1))


def reacher_time(start: Float[np.ndarray, " state"], goal: Float[np.ndarray, " state"]) -> float:
    """Time [s] from a state to rest at exactly two angles: the time of the slower joint."""
    return max(double_integrator_time(goal[i] - start[i], start[2 + i]) for i in range(2))


def double_integrator_time(distance: float, speed: float) -> float:
    """Shortest time to move by a distance and come to rest: full torque one way, then the other.

    With rate c = damping / inertia and push p = torque / inertia, the velocity tends to +-p / c as exp(-c t).
    """
    c, p = REACHER_DAMPING / REACHER_INERTIA, REACHER_TORQUE / REACHER_INERTIA
    stop = _after(0.0, speed, -np.sign(speed) * p, c, np.log1p(c * abs(speed) / p) / c)[0]
    side = 1.0 if distance >= stop else -1.0  # braking immediately stops before the goal on this side
    distance, speed = side * distance, side * speed

    def missed(push_time: float) -> float:
        x, v = _after(0.0, speed, p, c, push_time)
        if v <= 0:
            return -1.0
        return _after(x, v, -p, c, np.log1p(c * v / p) / c)[0] - distance

    first = max(0.0, np.log1p(-c * speed / p) / c if speed < 0 else 0.0)
    push = brentq(missed, first, 10.0) if missed(first) < 0 else first
    _, v = _after(0.0, speed, p, c, push)
    return float(push + np.log1p(c * max(v, 0.0) / p) / c)


def build_pendulum() -> None:
    """Every second point of the grid, which is enough for the plans that are compared with it."""
    theta, omega, value = pendulum_grid()
    _save("pendulum.npz", theta=theta[::2], omega=omega[::2], time=value[::2, ::2].astype(np.float32))


def build_cartpole() -> None:
    """Starts, and the best known duration from each."""
    problem = load_problem("cartpole-swingup")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "demos"
        config = PlanConfig.for_problem(problem, restarts=BEST_KNOWN_TRIES)
        plan_into(problem, out, num=BEST_KNOWN_STARTS, seed=0, config=config)
        demos = load_demos(out)
    first, last = demos.offsets[:-1], demos.offsets[1:] - 1
    _save("cartpole-swingup.npz", starts=demos.states[first], duration=demos.times[last], seed=np.array(0))


def build_truth() -> None:
    """For `planspace measure --truth`: starts of each problem, and the shortest time from each to its goal.

    The cart-pole's are the starts of `build_cartpole`, of seed 0; an embedding of demonstrations planned with
    that seed was trained on most of them.
    """
    rng = np.random.default_rng(1)
    starts = rng.uniform([-3.04, -2.9, -0.1, -0.1], [3.04, 2.9, 0.1, 0.1], (TRUTH_STARTS, 4))
    goal = np.array([0.0, 1.57, 0.0, 0.0])
    time = np.array([reacher_time(start, goal) for start in starts])
    _save("truth-reacher.npz", states=starts, time=time, goal=goal)
    starts = rng.uniform([-3.14, -0.1], [3.14, 0.1], (TRUTH_STARTS, 2))
    _save("truth-pendulum.npz", states=starts, time=pendulum_time(starts), goal=np.zeros(2))
    with np.load(FOLDER / "cartpole-swingup.npz") as best:
        _save("truth-cartpole-swingup.npz", states=best["starts"], time=best["duration"], goal=np.zeros(4))


def _save(name: str, **arrays: np.ndarray) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    FOLDER.mkdir(exist_ok=True)
    write_bytes(FOLDER / name, buffer.getvalue())
    print(f"{FOLDER / name}: {len(buffer.getvalue())} bytes")


def _after(x: float, v: float, push: float, c: float, t: float) -> tuple[float, float]:
    """Position and velocity of v' = push - c v after a time t."""
    final, decay = push / c, np.exp(-c * t)
    return x + final * t + (v - final) * (1 - decay) / c, final + (v - final) * decay


def _pendulum_step(x: np.ndarray, v: np.ndarray, torque: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """One Runge-Kutta step of the model in assets/pendulum.xml."""

    def slope(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return b, (PENDULUM_GRAVITY * np.sin(a) - PENDULUM_DAMPING * b + torque) / PENDULUM_INERTIA

    k1 = slope(x, v)
    k2 = slope(x + 0.5 * dt * k1[0], v + 0.5 * dt * k1[1])
    k3 = slope(x + 0.5 * dt * k2[0], v + 0.5 * dt * k2[1])
    k4 = slope(x + dt * k3[0], v + dt * k3[1])
    weights = (1, 2, 2, 1)
    a, b = (sum(w * k[i] for w, k in zip(weights, (k1, k2, k3, k4), strict=True)) * dt / 6 for i in range(2))
    return x + a, v + b


def _cells(a: np.ndarray, b: np.ndarray, theta: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, ...]:
    """Corner numbers and weights for linear interpolation; the angle wraps, the speed is clipped."""
    columns = len(omega)
    i = np.mod(a + np.pi, 2 * np.pi) / (theta[1] - theta[0])
    j = np.clip((b - omega[0]) / (omega[1] - omega[0]), 0, columns - 1.000001)
    low_i, low_j = np.minimum(i.astype(int), len(theta) - 2), j.astype(int)
    return low_i * columns + low_j, i - low_i, j - low_j, np.array(columns)


def _interpolate(value: np.ndarray, cells: tuple[np.ndarray, ...]) -> np.ndarray:
    corner, s, t, columns = cells
    flat = value.ravel()
    low = (1 - t) * flat[corner] + t * flat[corner + 1]
    high = (1 - t) * flat[corner + columns] + t * flat[corner + columns + 1]
    return (1 - s) * low + s * high


if __name__ == "__main__":
    build_pendulum()
    build_cartpole()
    build_truth()
