"""Seconds and file sizes of the plot commands on a dataset of a million states.

    python benchmarks/plot_size.py                                  # 20 demonstrations of 50,000 states
    python benchmarks/plot_size.py --demos 5000 --columns 8         # 5000 demonstrations of 200 states

The states are random walks with 27 columns by default, as in a recording of a human. The embedding is the
principal components, which need no training. Figures stay in --out.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.load import load_demos
from planspace.demos.state_info import StateInfo
from planspace.embed.fit import fit_embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.figures.demos import plot_demos
from planspace.figures.embedding_figures import draw_embedding
from planspace.figures.style import save_figure


def main() -> None:
    """Make the dataset and draw it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--states", type=int, default=1_000_000)
    parser.add_argument("--demos", type=int, default=20)
    parser.add_argument("--columns", type=int, default=27)
    parser.add_argument("--out", type=Path, default=None, help="a folder for the figures")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder, out = Path(scratch), args.out or Path(scratch) / "figures"
        _timed("make and save the dataset", lambda: _make(args).save(folder / "demos"), folder / "demos")
        demos = load_demos(folder / "demos")
        fit_embedding(demos, "pca", out=folder / "embedding", verbose=False)
        embedding = load_embedding(folder / "embedding")
        _timed("demos plot", lambda: save_figure(plot_demos(demos), out, "demos"), out)
        parts = out / "measure"
        _timed("measure --plot", lambda: draw_embedding(embedding, folder / "none", demos, parts), parts)


def _make(args: argparse.Namespace) -> Demos:
    rng = np.random.default_rng(0)
    length = args.states // args.demos
    info = StateInfo(tuple(f"c{k}" for k in range(args.columns)), ("",) * args.columns, (), 0)
    episodes = [
        Episode(
            states=rng.normal(size=(length, args.columns)).cumsum(axis=0),
            controls=np.zeros((length - 1, 0)),
            times=np.arange(length) * 0.05,
            goal=np.zeros(args.columns),
            success=True,
            index=i,
            seed=0,
        )
        for i in range(args.demos)
    ]
    return Demos.from_episodes(info, episodes)


def _timed(name: str, call: Callable[[], object], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    call()
    print(f"{name}: {time.perf_counter() - start:.1f} s", flush=True)
    for file in sorted(folder.glob("*.[hps]*[gl]")):
        print(f"    {file.name:<24}{file.stat().st_size / 1e6:8.2f} MB", flush=True)


if __name__ == "__main__":
    main()
