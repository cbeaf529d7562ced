"""Candidates for the `modern` preset, compared by geometry, decoded error and the return of one RL arm.

    python benchmarks/embedding_ablation.py DEMOS [--only NAME ...] [--embeddings 1] [--policies 15]

DEMOS contains swing-ups: `planspace plan cartpole-swingup --num 500 --out DEMOS`. Each candidate is trained
with five seeds; geometry is their mean on validation demonstrations. The RL arm is the swing-up, TRPO, raw +
sin/cos + z, 0.5 M steps, with the first `--embeddings` seeds; its return is the mean of the last ten
iterations. Policies of the same seed have the same episode starts and noise, so each arm is compared with the
prototype in pairs, by a bootstrap over embedding seeds and policies.

Metrics and returns are stored in results/embedding/candidates.csv; the same command trains what is missing.
"""

import argparse
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import matplotlib.figure
import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.config import PAPER_SPACINGS, PRESETS, FitConfig
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_seeds
from planspace.embed.geometry import measure
from planspace.rl.config import TrainConfig
from planspace.rl.training import train_policies
from planspace.storage.files import make_folder
from planspace.study.tidy import Row, read_rows, write_rows

FILE = Path(__file__).parents[1] / "results" / "embedding" / "candidates.csv"
STUDY = "candidates"
NUM_SEEDS = 5
STEPS, LAST = 500_000, 10
SHOWN = ("straightness", "speed_variation", "midpoint_error", "time_correlation")
SHOWN += ("effective_rank", "decoded_error")

MODERN = PRESETS["modern"]


BASELINE = "prototype, lambda 0.5"
PROTOTYPE = MODERN.with_settings(
    linearity=0.5,
    prior=1.0,
    off_data_weight=0.0,
    spacings=PAPER_SPACINGS,
    sigma_floor=0.05,
    steps=12_000,
    z_std=0.0,
    whitening=0.0,
)

CANDIDATES: dict[str, FitConfig] = {
    "modern": MODERN,
    BASELINE: PROTOTYPE,
    "z_std 0, whitening 0": MODERN.with_settings(z_std=0.0, whitening=0.0),
    "z_std 5": MODERN.with_settings(z_std=5.0),
    "whitening 0": MODERN.with_settings(whitening=0.0),
    "whitening 0.5": MODERN.with_settings(whitening=0.5),
    "whitening 1": MODERN.with_settings(whitening=1.0),
    "off_data_weight 0": MODERN.with_settings(off_data_weight=0.0),
    "lambda 0.5": MODERN.with_settings(linearity=0.5),
    "lambda 2": MODERN.with_settings(linearity=2.0),
    "lambda 4": MODERN.with_settings(linearity=4.0),
    "lambda 32": MODERN.with_settings(linearity=32.0),
    "prior 1": MODERN.with_settings(prior=1.0),
    "prior 0.01": MODERN.with_settings(prior=0.01),
    "short_fraction 0": MODERN.with_settings(short_fraction=0.0),
    "short_fraction 0, lambda 0.5": MODERN.with_settings(short_fraction=0.0, linearity=0.5),
    "short_fraction 0, lambda 2": MODERN.with_settings(short_fraction=0.0, linearity=2.0),
    "short_fraction 1": MODERN.with_settings(short_fraction=1.0),
    "short_fraction 1, lambda 32": MODERN.with_settings(short_fraction=1.0, linearity=32.0),
    "with mirror images": MODERN,
    "spacings 1, 3, 5, 10, 30": MODERN.with_settings(spacings=PAPER_SPACINGS),
    "raw inputs": MODERN.with_settings(inputs="raw"),
    "standardised inputs": MODERN.with_settings(inputs="standard"),
    "sigma floor 0.05": MODERN.with_settings(sigma_floor=0.05),
    "variance not doubled": MODERN.with_settings(double_variance=False),
    "balance 0.7": MODERN.with_settings(balance=0.7),
    "stop-gradient, balance 1": MODERN.with_settings(balance=1.0),
    "curvature 1": MODERN.with_settings(curvature=1.0),
    "distance 10": MODERN.with_settings(distance=10.0),
    "weight average": MODERN.with_settings(average=0.999),
    "2 x 128 units": MODERN.with_settings(hidden=(128, 128)),
    "batch 128": MODERN.with_settings(batch=128),
    "direct": MODERN.with_objective("direct"),
    "vae": MODERN.with_objective("vae"),
    "e2c": MODERN.with_objective("e2c").with_settings(linearity=1.0),
    "straightening": MODERN.with_objective("straightening").with_settings(linearity=5.0),
    "distance": MODERN.with_objective("distance"),
    "pca": MODERN.with_objective("pca"),
    "random": MODERN.with_objective("random"),
    "shuffled": MODERN.with_objective("shuffled"),
}
"""Each is `modern` with the change that its name says; `modern` should not be worse than `BASELINE`. The
candidate `with mirror images` is also trained on the mirror image of every training demonstration."""


Returns = dict[int, list[float]]
"""Final returns of the policies on each embedding, by its seed."""


def fitted(name: str, demos: Demos) -> list[Embedding]:
    """The embeddings of all seeds of a candidate."""
    trained_on = with_mirror_images(demos) if name == "with mirror images" else demos
    with tempfile.TemporaryDirectory() as folder:
        out, seeds = Path(folder), list(range(NUM_SEEDS))
        return fit_seeds(trained_on, out, config=CANDIDATES[name], seeds=seeds, split_seed=0)


def geometry_rows(name: str, embeddings: list[Embedding], demos: Demos) -> list[Row]:
    """The validation geometry of a candidate's embeddings."""
    validation = demos.split(0)["validation"]
    rows = []
    for seed, embedding in enumerate(embeddings):
        metrics = asdict(measure(embedding, demos, validation))
        rows += [Row(STUDY, name, seed, None, None, m, round(metrics[m], 5)) for m in SHOWN]
    return rows


def geometry_of(name: str, rows: list[Row]) -> dict[str, np.ndarray]:
    """The validation geometry of a candidate: each metric of its seeds."""
    own = [row for row in rows if row.arm == name]
    return {m: np.array([row.value for row in own if row.metric == m]) for m in SHOWN}


def returns_of(name: str, rows: list[Row]) -> Returns:
    """The final returns of a candidate's policies."""
    returns: Returns = {}
    for row in rows:
        if row.arm == name and row.metric == "final_return" and row.embedding is not None:
            returns.setdefault(row.embedding, []).append(row.value)
    return returns


def with_mirror_images(demos: Demos) -> Demos:
    """The training demonstrations and their mirror images: a swing-up with negated signs is one too."""
    episodes = [demos.episode(int(i)) for i in demos.split(0)["train"]]
    mirrored = [replace(e, states=-e.states, controls=-e.controls, goal=-e.goal) for e in episodes]
    return Demos.from_episodes(demos.info, episodes + mirrored)


def policy_returns(embedding: Embedding, first: int, count: int) -> list[float]:
    """Train policies `first`, `first` + 1, ... and return each one's mean return over its last iterations."""
    config = TrainConfig(obs="trig", z="augment", num_seeds=count, seed=first, steps=STEPS)
    trained = train_policies("cartpole-swingup", config, embedding=embedding)
    return trained.history["return"][-LAST:].mean(axis=0).tolist()


def run(name: str, demos: Demos, rows: list[Row], arguments: argparse.Namespace) -> None:
    """Measure what the rows lack of a candidate, add it to them and save them."""
    arms = returns_of(name, rows)
    missing = [i for i in range(_arms(name, arguments)) if len(arms.get(i, [])) < arguments.policies]
    measured = any(row.arm == name for row in rows)
    if measured and not missing:
        return
    embeddings = fitted(name, demos)
    if not measured:
        rows += geometry_rows(name, embeddings, demos)
        write_rows(rows, make_folder(FILE.parent) / FILE.name)
    for i in missing:
        first = len(arms.get(i, []))
        more = policy_returns(embeddings[i], first, arguments.policies - first)
        rows += [
            Row(STUDY, name, first + k, i, STEPS, "final_return", round(x, 2)) for k, x in enumerate(more)
        ]
        write_rows(rows, FILE)


def _arms(name: str, arguments: argparse.Namespace) -> int:
    return 0 if arguments.fit_only else min(arguments.embeddings, 1 if name == "pca" else NUM_SEEDS)


def paired_interval(a: Returns, b: Returns, rng: np.random.Generator) -> tuple[float, float, float]:
    """Mean difference of two arms and its 90 % interval, over embedding seeds and policies."""
    shared = sorted(k for k in set(a) & set(b) if a[k] and b[k])
    count = min(len(x[k]) for x in (a, b) for k in shared)
    difference = np.array([np.subtract(a[k][:count], b[k][:count]) for k in shared])
    draws = [
        difference[rng.integers(len(shared), size=len(shared))][:, rng.integers(count, size=count)].mean()
        for _ in range(4000)
    ]
    return float(difference.mean()), *np.quantile(draws, [0.05, 0.95])


def plot_trade_off(names: list[str], rows: list[Row]) -> matplotlib.figure.Figure:
    """Plot the return over straightness: what a straighter z costs a policy."""
    figure = matplotlib.figure.Figure(figsize=(7, 4.6), layout="constrained")
    axes = figure.subplots()
    points = []
    for name in names:
        arms = returns_of(name, rows)
        if not arms:
            continue
        straightness = geometry_of(name, rows)["straightness"]
        returns = np.concatenate([*arms.values()])
        error = returns.std(ddof=1) / np.sqrt(len(returns))
        colour = "crimson" if name in ("modern", BASELINE) else "0.35"
        x, y = straightness.mean(), returns.mean()
        axes.errorbar(x, y, error, straightness.std(), "o", color=colour, ms=4)
        points.append((x, y, name, colour))
    for x, y, name, colour in points:
        crowded = any(0 < other_x - x < 0.12 and abs(other_y - y) < 40 for other_x, other_y, *_ in points)
        side = {"xytext": (-6, -11), "ha": "right"} if crowded else {"xytext": (6, 5), "ha": "left"}
        axes.annotate(name, (x, y), textcoords="offset points", fontsize=8, color=colour, **side)
    axes.set_xlabel("straightness on validation demonstrations (bars: standard deviation over five seeds)")
    axes.set_ylabel("return of the policy (bars: standard error)")
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("demos", type=Path)
    parser.add_argument("--only", nargs="*", default=list(CANDIDATES), metavar="NAME")
    parser.add_argument("--embeddings", type=int, default=1)
    parser.add_argument("--policies", type=int, default=15)
    parser.add_argument("--fit-only", action="store_true")
    parser.add_argument("--plot", type=Path, help="draw return over straightness into this file")
    arguments = parser.parse_args()
    demos, rows = load_demos(arguments.demos), read_rows(FILE) if FILE.exists() else []
    for name in arguments.only:
        run(name, demos, rows, arguments)
    print("\n".join(table(arguments.only, rows)))
    if arguments.plot is not None:
        plot_trade_off(arguments.only, rows).savefig(arguments.plot)


def table(names: list[str], rows: list[Row]) -> list[str]:
    """The table of some candidates, in Markdown."""
    columns = ["candidate", *(name.replace("_", " ") for name in SHOWN)]
    columns += ["embeddings x policies", "return (se)", "against the baseline, paired, 90 %"]
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    baseline = returns_of(BASELINE, rows)
    for name in names:
        cells = [name]
        for values in geometry_of(name, rows).values():
            cells.append(f"{values.mean():.3f} ± {values.std():.3f}")
        if arms := returns_of(name, rows):
            values = np.concatenate([*arms.values()])
            cells.append(f"{len(arms)} x {len(next(iter(arms.values())))}")
            cells.append(f"{values.mean():.0f} ({values.std(ddof=1) / np.sqrt(len(values)):.0f})")
            if name != BASELINE and baseline:
                mean, low, high = paired_interval(arms, baseline, np.random.default_rng(0))
                cells.append(f"{mean:+.0f} ({low:+.0f} to {high:+.0f})")
        cells += [""] * (len(columns) - len(cells))
        lines.append("| " + " | ".join(cells) + " |")
    return lines


if __name__ == "__main__":
    main()
