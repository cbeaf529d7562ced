"""Simulated steps per second inside SST*, compared with bare `mujoco.batch` stepping.

    python benchmarks/plan_throughput.py [REPEATS [ROUNDS]]

Both step the same number of simulations and are timed in turn in one process, on all cores; the ratio is
computed pair by pair. SST* searches for 60 rounds (or ROUNDS) with everything that it does: selection,
pruning, extension, and the regulator.
"""

import sys
import time

import numpy as np
from mujoco.batch import Batch

from planspace.physics.simulator import Simulator
from planspace.plan.config import RegulatorConfig
from planspace.plan.query import Query
from planspace.plan.regulator import Regulator
from planspace.plan.sst import SST
from planspace.plan.sst_search import SSTSearch
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem

PROBLEMS = ("cartpole-swingup", "reacher", "pendulum", "acrobot", "quadrotor", "arm")
ROUNDS = int(sys.argv[2]) if len(sys.argv) > 2 else 60


def search_rate(problem: Problem, seed: int) -> tuple[float, int]:
    """Steps per second, and the size of the tree at the end."""
    model, space = problem.compile()
    config = SST(min_rounds=ROUNDS, max_rounds=ROUNDS)
    simulator = Simulator(model, space, config.extensions, validity=problem.validity)
    rng = np.random.default_rng(seed)
    start, goal = problem.draw_start(simulator, rng), problem.draw_goal(space, rng)
    regulator = Regulator(simulator, goal, problem.weights(space), RegulatorConfig())
    began = time.perf_counter()
    search = SSTSearch(config, Query(problem, start, goal, simulator, regulator), rng).solve()
    return search.simulated_steps / (time.perf_counter() - began), search.nodes


def bare_rate(problem: Problem, seed: int) -> float:
    """Steps per second of the same number of simulations under random controls, one step per call."""
    model, _ = problem.compile()
    count, steps = SST().extensions, 300
    batch = Batch(model, count, 0)
    controls = np.random.default_rng(seed).uniform(-1, 1, (steps, count, model.nu))
    live = batch.bind("ctrl")
    began = time.perf_counter()
    for control in controls:
        live[:] = control
        batch.step(nstep=1)
    return steps * count / (time.perf_counter() - began)


def main() -> None:
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    print(f"| problem | nodes | SST* steps/s | bare steps/s | ratio (minimum to maximum of {repeats}) |")
    print("|---|---|---|---|---|")
    for name in PROBLEMS:
        problem = load_problem(name)
        rows = []
        for seed in range(repeats):
            inside, nodes = search_rate(problem, seed)
            rows.append((inside, bare_rate(problem, seed), nodes))
        inside, bare, nodes = np.array(rows).T
        ratio = inside / bare
        print(
            f"| {name} | {np.median(nodes):,.0f} | {np.median(inside):,.0f} | {np.median(bare):,.0f} "
            f"| {np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f}) |"
        )


if __name__ == "__main__":
    main()
