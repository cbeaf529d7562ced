"""What following plans (`--follow-s`) is worth to control in plan space.

    python benchmarks/control_follow.py

Starts and lengths of episodes are those of `control.py`; plans and embeddings are the ready-made ones. A row
has 20 starts, with 0.16 s of foresight (`--horizon`) and 128 candidates. `follow_s` is 0 without following,
`followed` the fraction of control steps that follow a plan, and `seconds` the mean time of a control step on
one core.

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
SETTINGS = ("problem", "plans", "horizon_s", "cost", "follow_s")
COLUMNS = (*SETTINGS, "success", "return_mean", "followed", "seconds")
COSTS: tuple[CostName, ...] = ("z", "time", "raw", "reward")
FOLLOW_S = (0.0, 3.0)
NUM_STARTS, SAMPLES = 20, 128


def main() -> None:
    """Run the rows that the results do not have yet."""
    parser = make_parser(__doc__)
    parser.add_argument("--only", nargs="+", default=list(PROBLEMS), choices=PROBLEMS)
    parser.add_argument("--costs", nargs="+", default=list(COSTS), choices=COSTS)
    parser.add_argument("--horizon", type=float, default=0.16, metavar="S", help="how far to look ahead")
    options, rows = parse(parser, RESULTS, table)
    for name in options.only:
        plans = str(len(ps.load_demos(name)))
        for cost in options.costs:
            for follow in FOLLOW_S:
                key = {"problem": name, "cost": cost, "horizon_s": str(options.horizon)}
                key |= {"plans": plans, "follow_s": str(follow)}
                measured = partial(measure, name, cost, options.horizon, follow)
                add_missing(RESULTS, COLUMNS, rows, key, measured)


def measure(name: str, cost: CostName, horizon_s: float, follow_s: float) -> dict[str, str]:
    """Control the starts of one row."""
    plant = Plant.find(name)
    config = ControlConfig(horizon_s=horizon_s, samples=SAMPLES, cost=cost, follow_s=follow_s)
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
        f"| problem | plans | horizon [s] | {' | '.join(f'{cost} | following' for cost in COSTS)} |",
        f"|---|---|---|{'---|' * 2 * len(COSTS)}",
    ]
    found = {tuple(row[name] for name in SETTINGS): f"{float(row['success']):.0%}" for row in rows}
    order = list(PROBLEMS).index
    for key in sorted({key[:3] for key in found}, key=lambda key: (order(key[0]), key[2])):
        cells = [found.get((*key, cost, str(follow)), "") for cost in COSTS for follow in FOLLOW_S]
        lines.append(f"| {' | '.join((*key, *cells))} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
