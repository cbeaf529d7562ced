"""Distances of embeddings beside shortest times: rows of results/embedding/true_times.csv.

    planspace plan pendulum --num 60 --out pendulum
    planspace embed pendulum --steps 5000 --seeds 2 --out pendulum-z
    python benchmarks/true_times_table.py pendulum-z pendulum truth.npz

`true_times.py` makes truth.npz. `--table` only prints the table of docs/appendix/embeddings.md.
"""

import argparse
from pathlib import Path

from csv_rows import Row, read_rows, write_rows

from planspace.demos.load import load_demos
from planspace.embed.measurement import measure_embedding
from planspace.embed.saved_embedding import load_embedding

FILE = Path(__file__).parents[1] / "results" / "embedding" / "true_times.csv"
COLUMNS = ("problem", "subset", "distance", "num_pairs", "rank_correlation", "relative_error", "scale")
HEADER = "| problem | pairs | distance | number | rank correlation | relative error |"


def add(embedding: Path, demos: Path, truth: Path, label: str) -> None:
    """Measure one embedding, and put its rows in the place of older ones with the same name."""
    loaded = load_demos(demos)
    found = measure_embedding(load_embedding(embedding), loaded, truth=truth, verbose=False).to_dict()
    problem = label or str(loaded.info.problem)
    rows = [row for row in read_rows(FILE) if row["problem"] != problem]
    for subset, distances in found["true_times"].items():
        for distance, values in distances.items():
            row = {"problem": problem, "subset": subset, "distance": distance}
            row |= {name: f"{values[name]:.4g}" for name in COLUMNS[3:]}
            rows.append(row)
    write_rows(FILE, COLUMNS, rows)


def table(rows: list[Row]) -> list[str]:
    """Lines of the table of docs/appendix/embeddings.md."""
    lines = [HEADER, "|---|---|---|---|---|---|"]
    split = {row["problem"] for row in rows if row["subset"] != "all"}
    for row in rows:
        if row["subset"] != "all" or row["problem"] not in split:
            numbers = [f"{float(row[name]):.2f}" for name in ("rank_correlation", "relative_error")]
            cells = [row["problem"], row["subset"], row["distance"], row["num_pairs"], *numbers]
            lines.append(f"| {' | '.join(cells)} |".replace("_", " "))
    return lines


def main() -> None:
    """Read the options, measure, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", type=Path, nargs="*", help="EMBEDDING DEMOS TRUTH")
    parser.add_argument("--label", default="", help="name of the rows (default: the problem)")
    parser.add_argument("--table", action="store_true", help="only print the table")
    options = parser.parse_args()
    if not options.table:
        add(*options.paths, options.label)
    print("\n".join(table(read_rows(FILE))))


if __name__ == "__main__":
    main()
