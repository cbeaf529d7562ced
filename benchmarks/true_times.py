"""Shortest times between pairs of states, for `planspace measure --truth`.

    planspace plan pendulum --num 30 --seed 1000 --out plans
    python benchmarks/true_times.py pendulum --plans plans --out truth.npz
    python benchmarks/true_times.py cartpole-swingup --method polish --from-box --out box.npz

Half of the pairs lie on plans that no embedding was trained on: two states of one plan, and the time between
them along the plan. The other half do not. Their states and goals are states of motions under random controls
that begin in the problem's start box, no faster than the problem's `sample_velocity`. The times come from

- `grid` (default for two numbers): value iteration around each of `--goals` goals (`value_iteration.py`).
  `--checks` pairs of each goal are also planned, and the two times are compared.
- `polish` (default otherwise): motions at full control that switches at random times, polished to the
  shortest duration between their ends, and then treated as the plans are. The ends of `--checks` motions are
  planned from nothing, and the two durations are compared.

With `--from-box`, the motions of `polish` begin at states drawn uniformly from the start box, each motion is
one pair with its own goal, and no pairs on known plans are added.

A goal is reached at the problem's tolerance. Results are kept in FILE.parts, so the same command goes on.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import value_iteration as vi

from planspace.demos.load import load_demos
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.config import PlanConfig
from planspace.plan.pipeline import Pipeline
from planspace.plan.planner import Plan
from planspace.plan.query import Query
from planspace.plan.trajectory import Trajectory
from planspace.tasks.problem import Goal, Problem
from planspace.tasks.problem_file import load_problem

NODES, WIDTH = 120, 0.01
"""Of the grid: nodes while |delta| grows e-fold, and the distance of nodes at the goal."""
FASTEST = 1.5
"""Velocities of the grid reach this multiple of `sample_velocity`."""
MOTIONS, RANDOM_S, HOLD_STEPS = 512, 2.0, 4
"""Motions under random controls, their length, and the number of steps for which a control is held."""
ALONG = 5
"""Pairs taken along each polished motion."""
MOTION_S, HELD_S, TRIES = (0.2, 1.5), (0.04, 0.4), 64
"""Motions at full control: range of their duration, range of the time between switches, and draws."""
CHUNK = 8192
Pairs = dict[str, np.ndarray]


class Plant:
    """A problem, its goals, and simulations with steps of any length."""

    def __init__(self, problem: Problem):
        """Compile the problem."""
        self.problem = problem
        self.model, self.space = problem.compile()
        self.dt = self.model.opt.timestep
        self._simulators: dict[float, Simulator] = {}

    def step(self, states: np.ndarray, controls: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
        """Move each state by one Runge-Kutta step, and tell whether it is then valid."""
        if length not in self._simulators:
            self.model.opt.timestep = length
            self._simulators[length] = Simulator(
                self.model, self.space, CHUNK, threads=1, validity=self.problem.validity
            )
            self.model.opt.timestep = self.dt
        moved = [
            self._simulators[length].propagate(x, u, np.ones(len(x), dtype=int))
            for x, u in zip(_chunks(states), _chunks(controls), strict=True)
        ]
        ends, valid = zip(*moved, strict=True)
        return np.concatenate(ends), np.concatenate(valid)

    def goal(self, state: np.ndarray) -> Goal:
        """The goal region around a state."""
        weights, width = self.problem.weights_to_goal(self.space), np.zeros(self.space.tangent_size)
        return Goal(self.space, self.space.normalise(state), width, weights, self.problem.tolerance)

    def random_states(self, num: int, rng: np.random.Generator) -> np.ndarray:
        """States of motions under random controls from the start box."""
        simulator = Simulator(self.model, self.space, MOTIONS, threads=1)
        states = np.stack([self.problem.draw_start(simulator, rng) for _ in range(MOTIONS)])
        low, high = simulator.control_low, simulator.control_high
        fastest, kept = self.problem.speed(self.space), []
        valid = np.ones(MOTIONS, dtype=bool)
        for k in range(round(RANDOM_S / self.dt)):
            if k % HOLD_STEPS == 0:
                controls = rng.uniform(low, high, (MOTIONS, len(low)))
            states, fine = self.step(states, controls, self.dt)
            valid &= fine
            slow = (np.abs(states[:, self.space.velocities]) <= fastest).all(axis=1)
            kept.append(states[valid & slow])
        return self.space.normalise(rng.choice(np.concatenate(kept), num, replace=False))

    def box_states(self, num: int, rng: np.random.Generator) -> np.ndarray:
        """States drawn uniformly from the start box."""
        simulator = Simulator(self.model, self.space, 1, threads=1)
        return np.stack([self.problem.draw_start(simulator, rng) for _ in range(num)])

    def random_motion(self, start: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """States and controls from a start at full control: of `TRIES` the one that stays valid longest."""
        num_steps = round(rng.uniform(*MOTION_S) / self.dt)
        low, high = self.extremes()
        held = np.rint(rng.uniform(*HELD_S, (TRIES, num_steps)) / self.dt).astype(int)
        sides = rng.random((TRIES, num_steps, len(low))) < 0.5
        controls = np.stack(
            [
                np.repeat(np.where(s, low, high), h, axis=0)[:num_steps]
                for s, h in zip(sides, held, strict=True)
            ]
        )
        states, valid = [np.tile(start, (TRIES, 1))], [np.ones(TRIES, dtype=bool)]
        for k in range(num_steps):
            ends, fine = self.step(states[-1], controls[:, k], self.dt)
            states.append(ends)
            valid.append(valid[-1] & fine)
        lengths = np.sum(valid, axis=0) - 1
        best = lengths.argmax()
        return np.stack(states)[: lengths[best] + 1, best], controls[best, : lengths[best]]

    def extremes(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the controls."""
        simulator = Simulator(self.model, self.space, 1)
        return simulator.control_low, simulator.control_high


def time_grid(plant: Plant, goal: Goal) -> vi.Values:
    """The shortest times to one goal, by value iteration."""
    space = plant.space
    bound = FASTEST * plant.problem.speed(space)
    low, high = np.concatenate([space.low, -bound]), np.concatenate([space.high, bound])
    circles = np.isin(np.arange(space.size), space.circular_columns)
    axes = tuple(
        vi.circle_axis(WIDTH, NODES) if circle else vi.make_axis(below, above, WIDTH, NODES)
        for circle, below, above in zip(circles, low - goal.center, high - goal.center, strict=True)
    )
    grid = vi.Grid(axes)
    states = np.where(circles, goal.center + grid.deltas, np.clip(goal.center + grid.deltas, low, high))
    extremes = np.stack(np.meshgrid(*zip(*plant.extremes(), strict=True)), -1)
    difference = partial(_difference, space, goal.center)
    controls = extremes.reshape(-1, plant.model.nu)
    return vi.iterate(grid, states, difference, goal.reached, plant.step, controls)


def pairs_on_grid(
    plant: Plant, goal: Goal, states: np.ndarray, checks: int, rng: np.random.Generator
) -> Pairs:
    """Times from states to one goal by value iteration, with the durations of some plans."""
    found = np.where(goal.reached(states), 0.0, time_grid(plant, goal)(states))
    kept = found < 0.9 * vi.LONGEST
    pairs = _pairs(states[kept], goal.center, found[kept])
    plans = [planned(plant, x, goal, rng) for x in pairs["states"][:checks]]
    return pairs | {"check": np.array([_duration(plant, plan) for plan in plans])}


def pairs_polished(
    plant: Plant, starts: np.ndarray, checks: int, rng: np.random.Generator, *, whole: bool = False
) -> Pairs:
    """Pairs on motions from some states, polished; and durations of the motions, polished and planned.

    Args:
        plant: the problem.
        starts: where the motions begin.
        checks: number of motions whose ends are planned from nothing, too.
        rng: the source of randomness.
        whole: take the two ends of each motion as one pair, instead of pairs along it.
    """
    paths, goals, durations, again = [], [], [], []
    for start in starts:
        found = polished_motion(plant, start, rng)
        if found is not None:
            path, end = found
            paths.append(path.states)
            goals.append(end)
            durations.append(_duration(plant, path))
            if len(again) < checks:
                again.append(_duration(plant, planned(plant, start, plant.goal(end), rng)))
    if whole:
        begun = np.array([path[0] for path in paths])
        pairs = {"states": begun, "goals": np.array(goals), "time": np.array(durations)}
    else:
        pairs = pairs_on_paths(plant, paths, ALONG * len(paths), rng)
    return pairs | {"duration": np.array(durations), "check": np.array(again)}


def polished_motion(
    plant: Plant, start: np.ndarray, rng: np.random.Generator
) -> tuple[Trajectory, np.ndarray] | None:
    """A random motion, as short as the planner makes it, and where it ended; None if that failed."""
    motion, controls = plant.random_motion(start, rng)
    goal = plant.goal(motion[-1])
    if len(controls) == 0 or goal.reached(start):
        return None
    path = planned(plant, start, goal, rng, PlanConfig(planner=Known(controls), restarts=1))
    return None if path is None else (path, motion[-1])


def pairs_on_paths(plant: Plant, paths: Sequence[np.ndarray], num: int, rng: np.random.Generator) -> Pairs:
    """Two states of one path, and the time until the path enters the goal region of the later one."""
    rows = []
    for k in range(num):
        states = paths[k % len(paths)]
        i, j = np.sort(rng.choice(len(states), 2, replace=False))
        reached = plant.goal(states[j]).reached(states[i:])
        rows.append((states[i], states[j], np.argmax(reached) * plant.dt))
    states, goals, times = (np.array(column) for column in zip(*rows, strict=True))
    return {"states": states, "goals": goals, "time": times}


def planned(
    plant: Plant,
    start: np.ndarray,
    goal: Goal,
    rng: np.random.Generator,
    config: PlanConfig | None = None,
) -> Trajectory | None:
    """The shortest of the planner's plans; None if it found none. The goal need not be held."""
    problem = replace(plant.problem, hold=False)
    found = Pipeline(problem, config or PlanConfig.for_problem(problem)).connect(start, goal, rng)
    return found if isinstance(found, Trajectory) else None


@dataclass(frozen=True)
class Known:
    """A planner that returns a known path."""

    controls: np.ndarray

    def plan(self, query: Query, rng: np.random.Generator) -> Plan:
        """Return the path."""
        return Plan(self.controls)


def build(options: argparse.Namespace) -> None:
    """Compute the pairs part by part, and write them to one file."""
    plant = Plant(load_problem(options.problem))
    rng = np.random.default_rng(options.seed)
    goals = plant.random_states(options.goals, rng)
    on_grid = plant.space.size <= 2 if options.method is None else options.method == "grid"
    if options.from_box:
        starts = plant.box_states(options.goals * -(-options.pairs // options.goals), rng)
    else:
        per_goal = -(-options.pairs // (2 * options.goals))
        starts = plant.random_states(options.goals * (per_goal if on_grid else -(-per_goal // ALONG)), rng)
    parts = options.out.with_suffix(".parts")
    parts.mkdir(parents=True, exist_ok=True)
    for k, (center, x) in enumerate(zip(goals, np.split(starts, options.goals), strict=True)):
        path = parts / f"part-{k:03d}.npz"
        if path.exists():
            continue
        began, own = time.perf_counter(), np.random.default_rng([options.seed, k])
        if on_grid:
            part = pairs_on_grid(plant, plant.goal(center), x, options.checks, own)
        else:
            part = pairs_polished(plant, x, options.checks, own, whole=options.from_box)
        part["seconds"] = np.array(time.perf_counter() - began)
        np.savez(path, **part)
        print(f"part {k}: {len(part['time'])} pairs, {part['seconds']:.0f} s", flush=True)
    found = [dict(np.load(path)) for path in sorted(parts.glob("part-*.npz"))]
    off = {name: np.concatenate([part[name] for part in found]) for name in ("states", "goals", "time")}
    compare(found, on_grid)
    if options.from_box:
        np.savez_compressed(options.out, **off)
        print(f"{options.out}: {len(off['time'])} pairs, {seconds(found):.0f} s")
        return
    demos = load_demos(options.plans)
    paths = [demos.episode(i).states for i in range(len(demos))]
    on = pairs_on_paths(plant, paths, len(off["time"]), rng)
    joined = {name: np.concatenate([on[name], off[name]]) for name in off}
    on_plans = np.arange(len(joined["time"])) < len(on["time"])
    np.savez_compressed(options.out, **joined, on_plans=on_plans)
    print(f"{options.out}: {len(on_plans)} pairs, {seconds(found):.0f} s")


def seconds(found: list[Pairs]) -> float:
    """The time that the parts took [s]."""
    return float(sum(part["seconds"] for part in found))


def compare(found: list[Pairs], on_grid: bool) -> None:
    """Print the times of the pairs divided by the durations of the plans that check them."""
    times = [(part["time"] if on_grid else part["duration"])[: len(part["check"])] for part in found]
    ratio = np.concatenate(times) / np.concatenate([part["check"] for part in found])
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) == 0:
        return
    low, median, high = np.quantile(ratio, [0.1, 0.5, 0.9])
    print(f"time / duration of {len(ratio)} plans: 10 % {low:.3f}, median {median:.3f}, 90 % {high:.3f}")


def main() -> None:
    """Read the options and build the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problem")
    parser.add_argument("--plans", type=Path, help="plans that no embedding was trained on")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--goals", type=int, default=20, help="goals of the grid, or parts")
    parser.add_argument("--pairs", type=int, default=2000)
    parser.add_argument("--checks", type=int, default=1, help="checked pairs per goal or part")
    parser.add_argument("--method", choices=("grid", "polish"), help="default: grid for two numbers")
    parser.add_argument(
        "--from-box", action="store_true", help="motions from uniform states of the start box"
    )
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    if options.from_box and options.method != "polish":
        parser.error("--from-box needs --method polish")
    if options.plans is None and not options.from_box:
        parser.error("give --plans, a dataset that no embedding was trained on")
    build(options)


def _chunks(rows: np.ndarray) -> list[np.ndarray]:
    return [rows[i : i + CHUNK] for i in range(0, len(rows), CHUNK)]


def _difference(space: StateSpace, center: np.ndarray, states: np.ndarray) -> np.ndarray:
    return space.difference(states, center)


def _pairs(states: np.ndarray, goal: np.ndarray, times: np.ndarray) -> Pairs:
    return {"states": states, "goals": np.tile(goal, (len(states), 1)), "time": times}


def _duration(plant: Plant, plan: Trajectory | None) -> float:
    return np.nan if plan is None else (len(plan.states) - 1) * plant.dt


if __name__ == "__main__":
    main()
