"""Candidates for the `modern` preset, judged on geometry, on what z knows of the state, and on one RL arm.

    python benchmarks/embedding_ablation.py DEMOS [--only NAME ...] [--embeddings 1] [--policies 15]

DEMOS holds swing-ups: `planspace plan cartpole-swingup --num 500 --out DEMOS`. Each candidate is trained with
five seeds; geometry is the mean over them on validation demonstrations. The RL arm is the swing-up, TRPO, raw
+ sin/cos + z, 0.5 M steps, with the first `--embeddings` seeds; its figure is the mean return of the last ten
iterations. Policies of the same seed share episode starts and noise, so arms are compared pair by pair, here
with `baseline`, by a bootstrap over embedding seeds and policies.

Every unit is kept in results/embedding/ under the hash of what it depends on; the same command goes on.
"""

import argparse
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from planspace.demos.dataset import Demos, load_demos
from planspace.embed.config import PRESETS, FitConfig
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_seeds
from planspace.embed.geometry import measure
from planspace.rl.train import TrainConfig, train
from planspace.store import json_hash, make_folder, read_json, write_json

RESULTS = Path(__file__).parents[1] / "results" / "embedding"
NUM_SEEDS = 5
STEPS, LAST = 500_000, 10
BASELINE = "lambda 0.5, the paper's spacings"
SHOWN = ("straightness", "speed_variation", "midpoint_error", "time_correlation")
SHOWN += ("effective_rank", "decoded_error")

MODERN = PRESETS["modern"]


def vary(base: FitConfig = MODERN, **changes: object) -> FitConfig:
    """A preset with some fields changed; those of the objective go by their own names."""
    of_objective = {k: v for k, v in changes.items() if hasattr(base.objective, k)}
    rest = {k: v for k, v in changes.items() if k not in of_objective}
    return replace(base, objective=replace(base.objective, **of_objective), **rest)  # pyright: ignore


SHIPPED = (1, 3, 5, 10, 30)

CANDIDATES: dict[str, FitConfig] = {
    "modern": MODERN,
    BASELINE: vary(linearity=0.5, prior=1.0, spacings=SHIPPED, anywhere=0.0, z_deviation=0.0, whitening=0.0),
    "z as trained": vary(z_deviation=0.0, whitening=0.0),
    "z twice as large": vary(z_deviation=5.0),
    "nothing said of states anywhere": vary(anywhere=0.0),
    "lambda 0.5": vary(linearity=0.5),
    "lambda 2": vary(linearity=2.0),
    "lambda 32": vary(linearity=32.0),
    "prior 1": vary(prior=1.0),
    "prior 0.01": vary(prior=0.01),
    "spacings 1, 3, 5, 10, 30": vary(spacings=SHIPPED),
    "raw inputs": vary(inputs="raw"),
    "sigma floor 0.05": vary(sigma_floor=0.05),
    "variance not doubled": vary(double_variance=False),
    "balance 0.7": vary(balance=0.7),
    "curvature 1": vary(curvature=1.0),
    "distance 10": vary(distance=10.0),
    "weight average": vary(average=0.999),
    "not whitened": vary(whitening=0.0),
    "whitened by half": vary(whitening=0.5),
    "whitened": vary(whitening=1.0),
    "2 x 128 units": vary(hidden=(128, 128)),
    "batch 128": vary(batch=128),
    "direct": vary(name="direct"),
    "vae": vary(name="vae"),
    "e2c": vary(name="e2c", linearity=1.0),
    "straightening": vary(name="straightening", linearity=5.0),
    "distance": vary(name="distance"),
    "pca": vary(name="pca"),
    "random": vary(name="random"),
    "shuffled": vary(name="shuffled"),
}
"""Each is `modern` with what its name says; `BASELINE` is the prototype `modern` must not fall behind."""


def embeddings_of(name: str, config: FitConfig, demos: Demos) -> tuple[list[Embedding], dict]:
    """The embeddings of all seeds, and their validation geometry, from the results if it is there."""
    with tempfile.TemporaryDirectory() as folder:
        embeddings = fit_seeds(demos, Path(folder), config=config, seeds=list(range(NUM_SEEDS)), split_seed=0)
    validation = demos.split(0)["validation"]
    geometry = [asdict(measure(e, demos, validation)) for e in embeddings]
    return embeddings, {"candidate": name, "fit": asdict(config), "validation": geometry}


def policy_returns(embedding: Embedding | None, policies: int) -> list[float]:
    """Of each policy, the mean return of its last iterations."""
    config = TrainConfig(
        "cartpole-swingup", obs="trig", z="augment" if embedding else "none", num_seeds=policies, steps=STEPS
    )
    with tempfile.TemporaryDirectory() as folder:
        history = train(config, Path(folder) / "run", embedding)
    return history["return"][-LAST:].mean(axis=0).tolist()


def run(name: str, demos: Demos, arguments: argparse.Namespace) -> dict:
    """One candidate, as far as the results do not hold it yet."""
    config = CANDIDATES[name]
    unit = (
        RESULTS / f"{json_hash({'demos': demos.hash, 'fit': asdict(config), 'seeds': NUM_SEEDS})[:16]}.json"
    )
    result = read_json(unit) if unit.exists() else {}
    arms = result.get("returns", {})
    wanted = 0 if arguments.fit_only else min(arguments.embeddings, 1 if name == "pca" else NUM_SEEDS)
    missing = [i for i in range(wanted) if len(arms.get(str(i), [])) < arguments.policies]
    if result and not missing:
        return result
    embeddings, result = embeddings_of(name, config, demos)
    write_json(unit, {**result, "returns": arms})
    for i in missing:
        arms[str(i)] = policy_returns(embeddings[i], arguments.policies)
        write_json(unit, {**result, "returns": arms})
    return {**result, "returns": arms}


def paired_interval(a: dict, b: dict, rng: np.random.Generator) -> tuple[float, float, float]:
    """Mean difference of two arms and its 90 % interval, over embedding seeds and policies."""
    shared = sorted(set(a) & set(b))
    count = min(len(x[k]) for x in (a, b) for k in shared)
    difference = np.array([np.subtract(a[k][:count], b[k][:count]) for k in shared])
    draws = [
        difference[rng.integers(len(shared), size=len(shared))][:, rng.integers(count, size=count)].mean()
        for _ in range(4000)
    ]
    return float(difference.mean()), *np.quantile(draws, [0.05, 0.95])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("demos", type=Path)
    parser.add_argument("--only", nargs="*", default=list(CANDIDATES), metavar="NAME")
    parser.add_argument("--embeddings", type=int, default=1)
    parser.add_argument("--policies", type=int, default=15)
    parser.add_argument("--fit-only", action="store_true")
    arguments = parser.parse_args()
    make_folder(RESULTS)
    demos, rng = load_demos(arguments.demos), np.random.default_rng(0)
    results = {name: run(name, demos, arguments) for name in arguments.only}
    columns = ["candidate", *(name.replace("_", " ") for name in SHOWN)]
    columns += ["embeddings x policies", "return (se)", "against the baseline, paired, 90 %"]
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for name, result in results.items():
        cells = [name]
        for metric in SHOWN:
            values = np.array([g[metric] for g in result["validation"]])
            cells.append(f"{values.mean():.3f} ± {values.std():.3f}")
        arms = list(result["returns"].values())
        if arms:
            values = np.concatenate(arms)
            cells.append(f"{len(arms)} x {len(arms[0])}")
            cells.append(f"{values.mean():.0f} ({values.std(ddof=1) / np.sqrt(len(values)):.0f})")
        if arms and name != BASELINE and results.get(BASELINE, {}).get("returns"):
            mean, low, high = paired_interval(result["returns"], results[BASELINE]["returns"], rng)
            cells.append(f"{mean:+.0f} ({low:+.0f} to {high:+.0f})")
        cells += [""] * (len(columns) - len(cells))
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
