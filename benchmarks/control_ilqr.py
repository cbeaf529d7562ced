"""Whether refining sampled controls by iLQR makes control in plan space better.

    python benchmarks/control_ilqr.py

Starts and lengths of episodes are those of `control.py`; embeddings are the ready-made ones. Each row is 20
starts. `rounds` is 0 without iLQR, and `seconds` the median time of a control step on one core.

Rows are added to results/control/ilqr.csv. `--table` prints the table of docs/appendix/control.md.
"""

from functools import partial
from pathlib import Path

import numpy as np
from csv_rows import add_missing, make_parser, parse

import planspace as ps
from control import PROBLEMS
from planspace.control.config import ControlConfig
from planspace.control.episodes import run_episode
from planspace.control.plant import Plant

RESULTS = Path(__file__).parents[1] / "results" / "control" / "ilqr.csv"
COLUMNS = ("problem", "cost", "horizon_s", "samples", "rounds", "success", "return_mean", "seconds")
CASES = (
    ("cartpole-swingup", "z", 0.32),
    ("cartpole-swingup", "time", 0.32),
    ("quadrotor", "z", 0.16),
    ("arm", "z", 0.16),
)
SAMPLES, ROUNDS = (16, 128), (0, 1)
NUM_STARTS = 20


def main() -> None:
    """Run the rows that the results do not have yet."""
    parser = make_parser(__doc__)
    parser.add_argument("--only", default="", help="only problems whose name contains this")
    options, rows = parse(parser, RESULTS, table)
    for name, cost, horizon in (case for case in CASES if options.only in case[0]):
        for samples in SAMPLES:
            for rounds in ROUNDS:
                key = {"problem": name, "cost": cost, "horizon_s": str(horizon)}
                key |= {"samples": str(samples), "rounds": str(rounds)}
                measured = partial(measure, name, cost, horizon, samples, rounds)
                add_missing(RESULTS, COLUMNS, rows, key, measured)


def measure(name: str, cost: str, horizon: float, samples: int, rounds: int) -> dict[str, str]:
    """Control the starts of one row."""
    plant = Plant.find(name)
    config = ControlConfig(
        horizon_s=horizon, samples=samples, cost="time" if cost == "time" else "z", ilqr_rounds=rounds
    )
    controller = ps.Controller(plant, ps.load_embedding(name), config, threads=1)
    num_steps = round(PROBLEMS[name] / plant.control_step)
    episodes = [run_episode(controller, 0, i, num_steps) for i in range(NUM_STARTS)]
    free = np.concatenate([episode.seconds[~episode.regulated] for episode in episodes])
    return {
        "success": f"{np.mean([episode.success for episode in episodes]):.2f}",
        "return_mean": f"{np.mean([episode.rewards.sum() for episode in episodes]):.1f}",
        "seconds": f"{np.median(free):.3f}",
    }


def table(rows: list[dict[str, str]]) -> str:
    """Success without and with iLQR."""
    lines = [
        "| problem | cost | horizon | candidates | success | with iLQR | return | with iLQR | ms | with |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    without = {tuple(row[c] for c in COLUMNS[:4]): row for row in rows if row["rounds"] == "0"}
    for row in (row for row in rows if row["rounds"] == "1"):
        plain = without[tuple(row[c] for c in COLUMNS[:4])]
        ms, with_ms = (f"{1e3 * float(r['seconds']):.0f}" for r in (plain, row))
        lines.append(
            f"| {row['problem']} | {row['cost']} | {row['horizon_s']} s | {row['samples']} | "
            f"{float(plain['success']):.0%} | {float(row['success']):.0%} | {plain['return_mean']} | "
            f"{row['return_mean']} | {ms} | {with_ms} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
