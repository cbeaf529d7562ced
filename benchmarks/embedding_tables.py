"""Both presets on demonstrations never seen, five seeds each, z = 3 and 10.

    python benchmarks/embedding_tables.py NAME=DEMOS ... [--presets modern paper] [--z 3 10] [--linearity 2]

DEMOS is a dataset folder. For each preset and z it prints the metrics of the chosen seed on test
demonstrations (mean and deviation over the seeds), and the raw state's. Every row is kept in
results/embedding/tables/, with the curve of its training; the same command goes on.
"""

import argparse
import json
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.config import PRESETS, FitConfig
from planspace.embed.fit import choose, fit_seeds
from planspace.embed.geometry import measure, measure_raw_state
from planspace.seams import plain_settings
from planspace.storage.files import make_folder
from planspace.storage.json_files import json_hash, read_json, write_json

RESULTS = Path(__file__).parents[1] / "results" / "embedding" / "tables"
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


def row(name: str, demos: Demos, config: FitConfig, seeds: list[int]) -> dict:
    """One row, trained unless the results hold it."""
    unit = {
        "demos": demos.hash,
        "fit": plain_settings(config),
        "seeds": NUM_SEEDS if seeds == SEEDS else seeds,
    }
    file = RESULTS / f"{name}-{config.preset}-z{config.z_dim}-{json_hash(unit)[:12]}.json"
    if file.exists():
        return read_json(file)
    split = demos.split(0)
    began = time.time()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        embeddings = fit_seeds(demos, out, config=config, seeds=seeds, split_seed=0)
        log = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    kept, validation = choose(embeddings, demos, split, config)
    result = {
        "name": name,
        **unit,
        "seconds": round(time.time() - began, 1),
        "kept": kept,
        "test": [asdict(measure(e, demos, split["test"])) for e in embeddings],
        "validation": [asdict(g) for g in validation],
        "raw_state": asdict(measure_raw_state(demos, split["test"], split["train"])),
        "curve": [{**r, "time": round(r["time"] - began, 1)} for r in log if "straightness" in r],
    }
    write_json(file, result)
    return result


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
    make_folder(RESULTS)
    print("| | " + " | ".join(s.replace("_", " ") for s in SHOWN) + " | s |\n|" + "---|" * (len(SHOWN) + 2))
    for text in arguments.demos:
        name, _, source = text.partition("=")
        demos = load_demos(Path(source))
        for preset in arguments.presets:
            for z in arguments.z:
                steps = arguments.paper_steps if preset == "paper" else PRESETS[preset].steps
                changes = {"inputs": arguments.inputs, "linearity": arguments.linearity}
                changes = {name: value for name, value in changes.items() if value is not None}
                config = PRESETS[preset].with_settings(z_dim=z, steps=steps, **changes)
                result = row(name, demos, config, arguments.seeds)
                cells = []
                for metric in SHOWN:
                    values = np.array([g[metric] for g in result["test"]])
                    cells.append(f"{values[result['kept']]:.3f} ({values.mean():.3f} ± {values.std():.3f})")
                label = f"{name}, {preset}, z = {z}"
                print("| " + " | ".join([label, *cells, f"{result['seconds']:.0f}"]) + " |", flush=True)
        raw = [f"{result['raw_state'][metric]:.3f}" for metric in SHOWN]
        print("| " + " | ".join([f"{name}, raw state", *raw, ""]) + " |", flush=True)


if __name__ == "__main__":
    main()
