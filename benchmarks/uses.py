"""Ways to use plans in training, compared on one task with one algorithm, seed by seed.

    OPENBLAS_NUM_THREADS=1 python benchmarks/uses.py acrobot-swingup
    OPENBLAS_NUM_THREADS=1 python benchmarks/uses.py dmc:acrobot-swingup --plans DIR --embedding DIR \
        --steps 200000 --action-repeat 2 --seeds 5
    python benchmarks/uses.py acrobot-swingup --table

The study `planspace study uses` has the same arms on four tasks and plans by itself. This program takes any
plans and embedding, for example of a task whose plans take long. Its guide does not follow plans, and its
claims are about the last evaluation.

Grid, claims and their margin are fixed before seeds are run, except for the arms with cloning and with a
shuffled encoder and the claims about them, which were added later. Seeds from 300 decide the claims;
`--choose` runs seeds from 400 instead, on which settings may be chosen, and whose rows no claim reads. A unit
is a few seeds of an arm. Its rows are added to results/rl/uses.csv when it is finished, and then it is not
run again; an interrupted unit continues from its checkpoint in runs/uses. The guide is the plan-space
controller with the embedding: the episodes in which it reached the goal take the place of the plans.

The names of ready-made artefacts stand for plans and embedding. An algorithm without a
replay buffer has no arms that replay plans.
"""

import argparse
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from csv_rows import Row, read_rows, write_rows

from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.control.runs import DEMOS, control_into
from planspace.demos.load import load_demos
from planspace.embed.config import PRESETS
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.rl.training import train_policies
from planspace.seams import with_settings
from planspace.study.design import Claim
from planspace.study.stats import MIN_SEEDS, Scores, iqm, judge
from planspace.study.uses import MARGIN, Use, comparisons, ways
from planspace.tasks.catalog import find_task

FILE = Path(__file__).parent.parent / "results" / "rl" / "uses.csv"
COLUMNS = ("task", "algorithm", "settings", "arm", "seed", "num_plans", "step", "eval_return", "unit_cpu_s")
CLAIM_SEED, CHOICE_SEED = 300, 400
"""First seeds of the claims, and of choices."""
EVALUATIONS = 10
"""Evaluations of a training."""
GUIDE_EPISODES = 30
DMC_RANGE = (0.0, 1000.0)
"""The returns of any task of DeepMind Control."""


def unit_name(options: argparse.Namespace) -> str:
    """Text for everything but arm and seeds that a result depends on."""
    hidden = "x".join(map(str, options.hidden)) or "default"
    repeat = f", action repeat {options.action_repeat}" if options.action_repeat > 1 else ""
    reward = f", {options.reward} reward" if options.reward != "dense" else ""
    return f"{options.preset}, hidden {hidden}, {options.steps} steps{repeat}{reward}"


def settings_of(use: Use, options: argparse.Namespace, seed: int, num: int) -> TrainConfig:
    """The settings of a unit."""
    algorithm = find_algorithm(options.algo, options.preset)
    if options.hidden:
        algorithm = with_settings(
            algorithm, hidden=tuple(options.hidden), critic_hidden=tuple(options.hidden)
        )
    has_angles = bool(find_task(options.task).sin_cos_columns)
    config = TrainConfig(
        algorithm,
        obs="trig" if has_angles else "raw",
        steps=options.steps,
        seed=seed,
        num_seeds=num,
        action_repeat=options.action_repeat,
        reward=options.reward,
    )
    return replace(config, **use.settings, eval_every=max(1, config.iterations // EVALUATIONS))


def encoder_of(use: Use, options: argparse.Namespace) -> Embedding | None:
    """The embedding of an arm."""
    if not use.objective and not use.guided:
        return None
    if use.objective not in ("", "variational"):
        config = PRESETS["modern"].with_objective(use.objective)
        return fit_embedding(load_demos(options.plans), config=config, num_seeds=1, verbose=False)
    return load_embedding(options.embedding)


def plans_of(use: Use, options: argparse.Namespace, embedding: Embedding | None) -> Any:
    """The demonstrations that an arm uses; None without."""
    if use.guided:
        folder = options.out / f"{file_name(options.task)}-guide"
        control_into(
            Plant.find(options.task),
            embedding,
            ControlConfig(),
            folder,
            num=GUIDE_EPISODES,
            seed=0,
            workers=0,
        )
        return load_demos(folder / DEMOS)
    return load_demos(options.plans) if use.settings else None


def file_name(text: str) -> str:
    return re.sub(r"[^\w.-]+", "-", text)


def run_unit(arm: str, seeds: Sequence[int], options: argparse.Namespace) -> list[Row]:
    """Train some seeds of an arm, and return a row for each seed and evaluation."""
    use, start = options.ways[arm], time.process_time()
    config, embedding = settings_of(use, options, seeds[0], len(seeds)), encoder_of(use, options)
    plans = plans_of(use, options, embedding)
    name = file_name(f"{options.task}-{options.algo}-{unit_name(options)}-{arm}-{seeds[0]}")
    history = train_policies(
        options.task,
        config,
        embedding=embedding if use.objective else None,
        plans=plans,
        out=options.out / name,
        verbose=options.verbose,
    ).history
    seconds = round(time.process_time() - start, 1)
    same = {"task": options.task, "algorithm": options.algo, "settings": unit_name(options), "arm": arm}
    return [
        {
            **same,
            "seed": str(seed),
            "num_plans": str(0 if plans is None else len(plans)),
            "step": str(int(step)),
            "eval_return": f"{history['eval_return'][row, i]:.2f}",
            "unit_cpu_s": str(seconds),
        }
        for i, seed in enumerate(seeds)
        for row, step in enumerate(history["eval_steps"])
    ]


def scores_of(rows: Sequence[Row]) -> Scores:
    """The evaluations of an arm."""
    seeds, steps = (sorted({int(row[name]) for row in rows}) for name in ("seed", "step"))
    found = {(int(row["step"]), int(row["seed"])): float(row["eval_return"]) for row in rows}
    returns = np.array([[found[step, seed] for seed in seeds] for step in steps])
    return Scores(tuple(seeds), np.array(steps), returns, 0)


def last_evaluation(scores: Scores) -> Scores:
    """The scores with the last evaluation only."""
    return replace(scores, steps=scores.steps[-1:], returns=scores.returns[-1:])


def range_of_returns(options: argparse.Namespace) -> tuple[float, float]:
    """The lowest and the highest return; the sparse reward is at most 1 for each step."""
    task = find_task(options.task)
    return (0.0, task.horizon) if options.reward == "sparse" else task.return_range or DMC_RANGE


def table(rows: Sequence[Row], options: argparse.Namespace) -> list[str]:
    """The last evaluation of each arm, and the verdicts of claims, as lines of Markdown."""
    chosen = [
        row
        for row in rows
        if (row["task"], row["algorithm"], row["settings"])
        == (options.task, options.algo, unit_name(options))
        and CLAIM_SEED <= int(row["seed"]) < CHOICE_SEED
    ]
    found = {
        arm: scores_of(own) for arm in options.ways if (own := [row for row in chosen if row["arm"] == arm])
    }
    lines = ["| arm | seeds | last evaluation, interquartile mean (worst, best) | mean of all evaluations |"]
    lines += ["|---|---|---|---|"]
    for arm, scores in found.items():
        last = scores.returns[-1]
        numbers = f"{float(iqm(last)):.1f} ({last.min():.1f}, {last.max():.1f})"
        lines += [f"| {arm} | {len(scores.seeds)} | {numbers} | {scores.returns.mean():.1f} |"]
    lines += ["", "| claim | verdict | difference of the last evaluation (95 %) |", "|---|---|---|"]
    margin = MARGIN * float(np.diff(range_of_returns(options))[0])
    for text, arm, other in comparisons(options.replays):
        if {arm, other} <= set(found):
            last, base = (last_evaluation(found[name]) for name in (arm, other))
            verdict = judge(Claim(text, "ours", "final", arm, other, margin=margin), last, base)
            few, (low, high) = verdict.seeds < MIN_SEEDS, verdict.interval
            number = "too few seeds" if few else f"{verdict.number:.1f} ({low:.1f}, {high:.1f})"
            lines += [f"| {text} | {verdict.verdict} | {number} |"]
    return lines


def options_of(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("task", help="a name that `planspace train` takes")
    parser.add_argument("--algo", default="sac")
    parser.add_argument("--preset", default="modern")
    parser.add_argument("--hidden", type=int, nargs="*", default=[64, 64], help="units of the hidden layers")
    parser.add_argument("--steps", type=int, default=100_000, help="environment steps per seed")
    parser.add_argument("--action-repeat", type=int, default=1)
    parser.add_argument("--reward", default="dense", choices=("dense", "sparse"))
    parser.add_argument("--seeds", type=int, default=5, help="seeds of each arm")
    parser.add_argument("--block", type=int, default=5, help="seeds of a unit")
    parser.add_argument("--choose", action="store_true", help="run seeds on which settings may be chosen")
    parser.add_argument("--arms", nargs="+", metavar="ARM", help="by default all of the algorithm")
    parser.add_argument("--plans", default="", help="plans; the ready-made ones of the task by default")
    parser.add_argument("--embedding", default="", help="embedding; the ready-made one by default")
    parser.add_argument("--file", type=Path, default=FILE, help="where rows are added")
    parser.add_argument("--out", type=Path, default=Path("runs/uses"), help="folder of the runs")
    parser.add_argument("--table", action="store_true", help="only print the table and the claims")
    parser.add_argument("--verbose", action="store_true", help="show the progress of each unit")
    options = parser.parse_args(arguments)
    options.replays = getattr(find_algorithm(options.algo, options.preset), "replays", False)
    options.ways = ways(options.replays)
    options.arms = options.arms or list(options.ways)
    if unknown := [arm for arm in options.arms if arm not in options.ways]:
        parser.error(f"{options.algo} has no arm {unknown[0]!r}: choose from {', '.join(options.ways)}")
    options.plans, options.embedding = options.plans or options.task, options.embedding or options.task
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    options = options_of(arguments)
    first = CHOICE_SEED if options.choose else CLAIM_SEED
    blocks = range(first, first + options.seeds, options.block)
    for start in () if options.table else blocks:  # first all arms of a block, so that arms can be compared
        seeds = range(start, min(start + options.block, first + options.seeds))
        for arm in options.arms:
            rows = read_rows(options.file)
            key = (options.task, options.algo, unit_name(options), arm, str(start))
            if any(tuple(row[n] for n in (*COLUMNS[:4], "seed")) == key for row in rows):
                continue
            found = run_unit(arm, seeds, options)
            rows = read_rows(options.file)  # again, because other arms may have been added
            write_rows(options.file, COLUMNS, rows + found)
            print(f"{arm}: seeds {seeds[0]} to {seeds[-1]} done", flush=True)
    print("\n".join(table(read_rows(options.file), options)))


if __name__ == "__main__":
    main()
