"""Metrics of both presets on test demonstrations, with five seeds each and z = 3 and 10.

    python benchmarks/embedding_tables.py NAME=DEMOS ... [--presets modern paper] [--z 3 10] [--linearity 2]

DEMOS is a dataset folder. For each preset and z it prints the metrics of the selected seed on test
demonstrations (mean and standard deviation over the seeds), and those of the raw state. The metrics of each
seed are stored in results/embedding/tables.csv; rows that it contains are not trained again.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.config import PRESETS, FitConfig
from planspace.embed.fit import choose, fit_seeds
from planspace.embed.geometry import measure, measure_raw_state
from planspace.embed.objectives.variational import Variational
from planspace.storage.files import make_folder
from planspace.study.execute import cpu_model
from planspace.study.tidy import Row, read_rows, write_rows

FILE = Path(__file__).parents[1] / "results" / "embedding" / "tables.csv"
STUDY, COMMAND = "embeddings", "python benchmarks/embedding_tables.py"
PAPER_STEPS = 200_000
"""Steps of the preset `paper` in the tables."""
NUM_SEEDS = 5
SEEDS = list(range(NUM_SEEDS))
SHOWN = (
    "straightness",
    "speed_variation",
    "midpoint_error",
    "time_correlation",
    "path_error",
    "effective_rank",
)
SHOWN += ("decoded_error",)


def label_of(name: str, config: FitConfig) -> str:
    """The name of a row: dataset, preset, size of z, and settings that differ from the table's."""
    preset = PRESETS[config.preset]
    parts = [name, config.preset, f"z = {config.z_dim}"]
    if config.steps not in (preset.steps, PAPER_STEPS):
        parts.append(f"{config.steps:,} steps")
    if config.inputs != preset.inputs:
        parts.append(f"inputs {config.inputs}")
    if isinstance(config.objective, Variational) and config.objective != preset.objective:
        parts.append(f"linearity {config.objective.linearity:g}")
    return ", ".join(parts)


def trained(label: str, demos: Demos, config: FitConfig, seeds: list[int]) -> list[Row]:
    """Train the embeddings of a row and return their metrics."""
    split = demos.split(0)
    began = time.time()
    with tempfile.TemporaryDirectory() as folder:
        embeddings = fit_seeds(demos, Path(folder), config=config, seeds=seeds, split_seed=0)
    selected, _ = choose(embeddings, demos, split, config)
    head = Row(STUDY, label, None, None, config.steps, "", 0.0)
    rows = []
    for seed, embedding in zip(seeds, embeddings, strict=True):
        metrics = asdict(measure(embedding, demos, split["test"]))
        rows += [head._replace(seed=seed, metric=m, value=round(metrics[m], 5)) for m in SHOWN]
    rows.append(head._replace(seed=seeds[selected], metric="selected", value=1.0))
    seconds = round(time.time() - began, 1)
    return [*rows, head._replace(metric="seconds", value=seconds, command=COMMAND, cpu=cpu_model())]


def table_row(rows: list[Row]) -> list[str]:
    """The cells of a row: the selected seed, mean and standard deviation over the seeds."""
    (selected,) = (row.seed for row in rows if row.metric == "selected")
    cells = []
    for metric in SHOWN:
        values = {row.seed: row.value for row in rows if row.metric == metric}
        over_seeds = np.array([*values.values()])
        spread = f" ({over_seeds.mean():.3f} ± {over_seeds.std():.3f})" if len(values) > 1 else ""
        cells.append(f"{values[selected]:.3f}{spread}")
    return cells


def raw_state_rows(name: str, demos: Demos) -> list[Row]:
    """The metrics of the standardised raw state."""
    split = demos.split(0)
    metrics = asdict(measure_raw_state(demos, split["test"], split["train"]))
    head = Row(STUDY, f"{name}, raw state", None, None, None, "", 0.0)
    return [head._replace(metric=metric, value=round(metrics[metric], 5)) for metric in SHOWN]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("demos", nargs="+", metavar="NAME=DEMOS")
    parser.add_argument("--presets", nargs="*", default=["modern", "paper"])
    parser.add_argument("--z", nargs="*", type=int, default=[3, 10])
    parser.add_argument("--seeds", nargs="*", type=int, default=SEEDS)
    parser.add_argument("--inputs", default=None)
    parser.add_argument("--linearity", type=float, default=None)
    parser.add_argument("--paper-steps", type=int, default=300_000)
    arguments = parser.parse_args()
    stored = read_rows(FILE) if FILE.exists() else []

    def rows_of(label: str, make: Callable[[], list[Row]]) -> list[Row]:
        if all(row.arm != label for row in stored):
            stored.extend(make())
            write_rows(stored, make_folder(FILE.parent) / FILE.name)
        return [row for row in stored if row.arm == label]

    print("| | " + " | ".join(s.replace("_", " ") for s in SHOWN) + " |\n|" + "---|" * (len(SHOWN) + 1))
    for text in arguments.demos:
        name, _, source = text.partition("=")
        demos = load_demos(Path(source))
        for preset in arguments.presets:
            for z in arguments.z:
                steps = arguments.paper_steps if preset == "paper" else PRESETS[preset].steps
                changes = {"inputs": arguments.inputs, "linearity": arguments.linearity}
                changes = {name: value for name, value in changes.items() if value is not None}
                config = PRESETS[preset].with_settings(z_dim=z, steps=steps, **changes)
                label = label_of(name, config)
                rows = rows_of(label, partial(trained, label, demos, config, arguments.seeds))
                print("| " + " | ".join([label, *table_row(rows)]) + " |", flush=True)
        rows = rows_of(f"{name}, raw state", partial(raw_state_rows, name, demos))
        raw = [f"{row.value:.3f}" for row in rows]
        print("| " + " | ".join([f"{name}, raw state", *raw]) + " |", flush=True)


if __name__ == "__main__":
    main()
