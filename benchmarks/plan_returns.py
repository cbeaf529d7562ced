"""Carry out the plans of a dataset in their task, and count the task's own reward.

    python benchmarks/plan_returns.py dmc:acrobot-swingup PLANS

From the start of each plan, the controls of the plan are applied as they are; then the linear regulator holds
the goal to the end of the episode. This is what a planner that knows the model earns, beside policies that
learn. The last columns are the fraction of episodes that are at the goal for their whole last second, and the
mean duration of the plans. The row is added to results/control/plan_returns.csv.
"""

import argparse
from pathlib import Path

import numpy as np
from csv_rows import Row, read_rows, write_rows

from planspace.control.episodes import LAST_S
from planspace.control.plant import Plant
from planspace.demos.episode import Episode
from planspace.demos.load import load_demos
from planspace.plan.config import RegulatorConfig
from planspace.plan.regulator import Regulator

FILE = Path(__file__).parent.parent / "results" / "control" / "plan_returns.csv"
COLUMNS = ("task", "plans", "hash", "return_mean", "return_worst", "return_best", "held", "duration_s")


def carry_out(plant: Plant, regulator: Regulator, plan: Episode) -> tuple[float, bool]:
    """The return of one plan, and whether the goal is held for the last second."""
    task, simulator, target = plant.task, plant.simulator(1), np.empty((1, 0))
    state, total, at_goal = plan.states[:1], 0.0, []
    simulator.reset(state)
    for step in range(task.horizon):
        before, applied = state, []
        for physics_step in range(step * task.frame_skip, (step + 1) * task.frame_skip):
            planned = physics_step < len(plan.controls)
            control = plan.controls[physics_step] if planned else regulator.control(state[0])
            applied.append(np.clip(control, simulator.control_low, simulator.control_high))
            simulator.step(applied[-1][None], 1)
            state = simulator.states()
        total += float(task.reward(before, state, np.mean(applied, axis=0)[None], target)[0])
        at_goal.append(bool(task.at_goal(state, target)[0]))
    return total, all(at_goal[-max(1, round(LAST_S / plant.control_step)) :])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("task", help="a task with one goal state and a planning problem")
    parser.add_argument("plans", type=Path, help="plans of its problem")
    options = parser.parse_args()
    plant, demos = Plant.find(options.task), load_demos(options.plans)
    plans = [demos.episode(i) for i in range(len(demos))]
    weights, goal = plant.problem.weights(plant.space), plant.goal(np.empty(0))
    regulator = Regulator(plant.simulator(1), goal, weights, RegulatorConfig())
    found = [carry_out(plant, regulator, plan) for plan in plans]
    returns = np.array([total for total, _ in found])
    row: Row = {
        "task": options.task,
        "plans": str(len(plans)),
        "hash": demos.hash[:12],
        "return_mean": f"{returns.mean():.1f}",
        "return_worst": f"{returns.min():.1f}",
        "return_best": f"{returns.max():.1f}",
        "held": f"{np.mean([held for _, held in found]):.2f}",
        "duration_s": f"{np.mean([plan.times[-1] for plan in plans]):.2f}",
    }
    print(*(f"{name}: {text}" for name, text in row.items()), sep="\n")
    write_rows(FILE, COLUMNS, [*(old for old in read_rows(FILE) if old["hash"] != row["hash"]), row])


if __name__ == "__main__":
    main()
