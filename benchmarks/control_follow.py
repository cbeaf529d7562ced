"""What following plans (`--follow-s`) is worth to control in plan space.

    python benchmarks/control_follow.py

Starts and lengths of episodes are those of `control.py`; plans and embeddings are the ready-made ones. A row
has 20 starts, with 0.16 s of foresight and 128 candidates. `follow_s` is 0 without following, `followed` the
fraction of control steps that follow a plan, and `seconds` the mean time of a control step on one core.

Rows are added to results/control/follow.csv. `--table` prints the table of docs/appendix/control.md.
"""

from functools import partial
from pathlib import Path

import numpy as np
from csv_rows import add_missing, make_parser, parse

import planspace as ps
from control import PROBLEMS
from planspace.control.config import ControlConfig, CostName
from planspace.control.episodes import run_episode
from planspace.control.plant import Plant

RESULTS = Path(__file__).parents[1] / "results" / "control" / "follow.csv"
COLUMNS = ("problem", "cost", "plans", "follow_s", "success", "return_mean", "followed", "seconds")
COSTS: tuple[CostName, ...] = ("z", "time", "raw", "reward")
FOLLOW_S = (0.0, 3.0)
NUM_STARTS, HORIZON_S, SAMPLES = 20, 0.16, 128


def main() -> None:
    """Run the rows that the results do not have yet."""
    parser = make_parser(__doc__)
    parser.add_argument("--only", nargs="+", default=list(PROBLEMS), choices=PROBLEMS)
    options, rows = parse(parser, RESULTS, table)
    for name in options.only:
        plans = str(len(ps.load_demos(name)))
        for cost in COSTS:
            for follow in FOLLOW_S:
                key = {"problem": name, "cost": cost, "plans": plans, "follow_s": str(follow)}
                add_missing(RESULTS, COLUMNS, rows, key, partial(measure, name, cost, follow))


def measure(name: str, cost: CostName, follow_s: float) -> dict[str, str]:
    """Control the starts of one row."""
    plant = Plant.find(name)
    config = ControlConfig(horizon_s=HORIZON_S, samples=SAMPLES, cost=cost, follow_s=follow_s)
    embedding, plans = ps.load_embedding(name), ps.load_demos(name)
    controller = ps.Controller(plant, embedding, config, plans=plans, threads=1)
    num_steps = round(PROBLEMS[name] / plant.control_step)
    episodes = [run_episode(controller, 0, i, num_steps) for i in range(NUM_STARTS)]
    return {
        "success": f"{np.mean([episode.success for episode in episodes]):.2f}",
        "return_mean": f"{np.mean([episode.rewards.sum() for episode in episodes]):.1f}",
        "followed": f"{np.concatenate([episode.followed for episode in episodes]).mean():.2f}",
        "seconds": f"{np.concatenate([episode.seconds for episode in episodes]).mean():.3f}",
    }


def table(rows: list[dict[str, str]]) -> str:
    """Success without and with following."""
    lines = [
        f"| problem | plans | {' | '.join(f'{cost} | following' for cost in COSTS)} |",
        f"|---|---|{'---|' * 2 * len(COSTS)}",
    ]
    found = {(row["problem"], row["cost"], float(row["follow_s"])): row["success"] for row in rows}
    plans = {row["problem"]: row["plans"] for row in rows}
    for name in (name for name in PROBLEMS if name in plans):
        cells = [found.get((name, cost, follow)) for cost in COSTS for follow in FOLLOW_S]
        shown = " | ".join("" if cell is None else f"{float(cell):.0%}" for cell in cells)
        lines.append(f"| {name} | {plans[name]} | {shown} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
