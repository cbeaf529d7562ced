"""Reward shaping at several scales: by distance in z, by time to go and by raw distance.

    OPENBLAS_NUM_THREADS=1 python benchmarks/shaping_scales.py runs/shaping
    python benchmarks/shaping_scales.py --table

The task is the swing-up with the sparse reward: 1 for each of at most 200 steps that end at the goal. The
algorithm is TRPO with the `paper` preset; the policies observe the state, sin and cos. The scale is the
return of the shaping from a mean start to the goal. z and time to go come from the ready-made embedding. A
claim needs a difference of more than 10, which is 5 % of the range of returns. Arms, scales, seeds, steps and
margin were fixed before a seed was run.

Rows are added to results/rl/shaping.csv arm by arm.
"""

from dataclasses import replace
from pathlib import Path

from csv_rows import Row, has_row, make_parser, parse, write_rows
from uses import last_evaluation, scores_of

import planspace as ps
from planspace.rl.config import TrainConfig
from planspace.study.design import Claim
from planspace.study.stats import Scores, iqm, judge

RESULTS = Path(__file__).parents[1] / "results" / "rl" / "shaping.csv"
COLUMNS = ("shaping", "scale", "seed", "step", "eval_return")
TASK, SEED, NUM_SEEDS, STEPS, EVALUATIONS = "cartpole-swingup", 300, 15, 600_000, 10
SCALES = (1.0, 3.0, 10.0)
NONE = ("none", 0.0)
ARMS = (NONE, *((name, scale) for name in ("z", "time", "raw") for scale in SCALES))
MARGIN = 10.0


def main() -> None:
    """Run the arms that the results do not have yet."""
    options, rows = parse(make_parser(__doc__, "where the runs are kept"), RESULTS, table)
    for name, scale in ARMS:
        key = {"shaping": name, "scale": f"{scale:g}"}
        if not has_row(rows, key):
            rows += [key | row for row in run_arm(options.folder / f"{name}-{scale:g}", name, scale)]
            write_rows(RESULTS, COLUMNS, rows)
            print(name, f"{scale:g}", "done", flush=True)
    print(table(rows))


def run_arm(folder: Path, name: str, scale: float) -> list[Row]:
    """Train the seeds of an arm; return a row for each seed and evaluation."""
    config = TrainConfig(obs="trig", reward="sparse", seed=SEED, num_seeds=NUM_SEEDS, steps=STEPS)
    config = replace(config, eval_every=config.iterations // EVALUATIONS)
    if name != "none":
        config = replace(config, shaping=name, shaping_scale=scale)
    embedding = ps.load_embedding(TASK) if name in ("z", "time") else None
    run = ps.train_policies(TASK, config, embedding=embedding, out=folder, verbose=False)
    returns, steps = run.history["eval_return"], run.history["eval_steps"]
    return [
        {"seed": str(SEED + i), "step": str(int(step)), "eval_return": f"{returns[row, i]:.2f}"}
        for i in range(NUM_SEEDS)
        for row, step in enumerate(steps)
    ]


def table(rows: list[Row]) -> str:
    """The last evaluation of each arm, and whether it is better than without shaping."""
    lines = [
        "| shaping | scale | last evaluation, interquartile mean (worst, best) | better than none |",
        "|---|---|---|---|",
    ]
    found = {arm: own for arm in ARMS if (own := [row for row in rows if arm_of(row) == arm])}
    for (name, scale), own in found.items():
        scores = last_evaluation(scores_of(own))
        last = scores.returns[-1]
        verdict = "" if (name, scale) == NONE else verdict_of(scores, last_evaluation(scores_of(found[NONE])))
        shown = f"{scale:g}" if scale else ""
        lines.append(
            f"| {name} | {shown} | {float(iqm(last)):.0f} ({last.min():.0f}, {last.max():.0f}) | {verdict} |"
        )
    return "\n".join(lines)


def arm_of(row: Row) -> tuple[str, float]:
    """Shaping and scale of a row."""
    return row["shaping"], float(row["scale"])


def verdict_of(scores: Scores, base: Scores) -> str:
    """The verdict on "shaping helps", with the difference and its interval."""
    verdict = judge(Claim("shaping helps", "ours", "final", "a", "b", margin=MARGIN), scores, base)
    low, high = verdict.interval
    return f"{verdict.verdict}: {verdict.number:.0f} ({low:.0f}, {high:.0f})"


if __name__ == "__main__":
    main()
