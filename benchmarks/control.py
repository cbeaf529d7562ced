"""Compare costs of receding-horizon control.

    python benchmarks/control.py runs/control

The costs are the distance in z, the time to go, the reward, and for comparison the distance in the
standardised state and in the z of other encoders. For each problem, 60 plans and their search trees are made,
and encoders are trained on them: the default with a time head, one on shuffled plans and one with random
weights. For each cost and horizon, the same 20 starts are controlled. An episode succeeds if it is at the
goal for its whole last second. All cells use the default settings with 128 samples. Their noise was chosen on
the swing-up at 0.32 s and on the acrobot, from other starts (seed 5). No reward is used except by the cost
`reward`.

Plans, encoders and episodes are kept in the folder, so the same command goes on. Rows are added to
results/control/costs.csv cell by cell. `--table` prints the table of docs/appendix/control.md.
"""

from functools import partial
from pathlib import Path

from csv_rows import add_missing, make_parser, parse

from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.control.runs import control_into
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_demos

RESULTS = Path(__file__).parents[1] / "results" / "control" / "costs.csv"
PROBLEMS = {
    "cartpole-swingup": 8.0,
    "pendulum-swingup": 8.0,
    "quadrotor-planar": 6.0,
    "acrobot-swingup": 10.0,
    "reacher": 4.0,
    "ball-pendulum": 6.0,
    "quadrotor": 6.0,
    "arm": 6.0,
}
"""Tasks, or problems without one, and the length of an episode [s]."""
COSTS = {
    "z": "variational",
    "time": "variational",
    "raw": "variational",
    "reward": "",
    "shuffled": "shuffled",
    "random": "random",
}
"""Cost and the objective of the encoder that it needs."""
HORIZONS = (0.08, 0.16, 0.32, 0.64, 1.0, 1.5)
COLUMNS = (
    "problem",
    "cost",
    "horizon_s",
    "regulator",
    "success",
    "return_mean",
    "return_worst",
    "real_time",
)
NUM_PLANS, NUM_STARTS, SAMPLES = 60, 20, 128


def main() -> None:
    """Run the cells that the results do not have yet."""
    parser = make_parser(__doc__, "where plans, encoders and episodes are kept")
    parser.add_argument("--only", default="", help="only problems whose name contains this")
    parser.add_argument("--costs", nargs="+", default=list(COSTS), choices=COSTS)
    parser.add_argument("--horizons", nargs="+", type=float, default=list(HORIZONS), metavar="S")
    parser.add_argument("--no-regulator", action="store_true", help="without the regulator at the goal")
    options, rows = parse(parser, RESULTS, table)
    regulator = not options.no_regulator
    for name in (name for name in PROBLEMS if options.only in name):
        for cost in options.costs:
            for horizon in options.horizons:
                cell = {"problem": name, "cost": cost, "horizon_s": str(horizon), "regulator": str(regulator)}
                measured = partial(measure, options.folder, name, cost, horizon, regulator)
                add_missing(RESULTS, COLUMNS, rows, cell, measured)


def measure(folder: Path, name: str, cost: str, horizon: float, regulator: bool) -> dict[str, str]:
    """Control the starts of one cell."""
    plant = Plant.find(name)
    encoder = encoder_of(folder, plant, COSTS[cost]) if COSTS[cost] else None
    config = ControlConfig(
        horizon_s=horizon,
        samples=SAMPLES,
        cost=cost if cost in ("time", "raw", "reward") else "z",
        regulator=regulator,
    )
    out = folder / f"{name}-{cost}-{horizon}{'' if regulator else '-alone'}"
    found = control_into(plant, encoder, config, out, num=NUM_STARTS, seed=0, episode_s=PROBLEMS[name])
    return {
        "success": f"{found.success:.2f}",
        "return_mean": f"{found.return_mean:.1f}",
        "return_worst": f"{found.return_worst:.1f}",
        "real_time": f"{found.real_time:.2f}",
    }


def encoder_of(folder: Path, plant: Plant, objective: str) -> Embedding:
    """The encoder of a problem's plans; both are made once."""
    problem = plant.problem
    planning = PlanConfig.for_problem(problem, keep_trees=True)
    demos = plan_demos(problem, NUM_PLANS, config=planning, out=folder / f"{problem.name}-trees")
    head = objective == "variational"
    out = folder / f"{problem.name}-{objective}{'-time' if head else ''}"
    return fit_embedding(demos, objective, time_head=head, out=out)


def table(rows: list[dict[str, str]]) -> str:
    """Success of each cost, one column a horizon."""
    horizons = sorted({row["horizon_s"] for row in rows}, key=float)
    lines = [
        f"| problem | cost | {' | '.join(f'{h} s' for h in horizons)} |",
        f"|---|---|{'---|' * len(horizons)}",
    ]
    cells = {(r["problem"], r["cost"], r["regulator"], r["horizon_s"]): r["success"] for r in rows}
    order = {name: place for place, name in enumerate((*PROBLEMS, *COSTS))}
    for problem, cost, regulator in sorted(
        {key[:3] for key in cells}, key=lambda k: [order[n] for n in k[:2]]
    ):
        shown = [cells.get((problem, cost, regulator, h)) for h in horizons]
        values = " | ".join("" if value is None else f"{float(value):.0%}" for value in shown)
        lines.append(f"| {problem} | {cost}{'' if regulator == 'True' else ', no regulator'} | {values} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
