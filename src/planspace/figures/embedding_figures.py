"""An embedding in pictures: the figures `planspace measure --plot` leaves in a folder."""

from pathlib import Path

import matplotlib.figure
import numpy as np

from planspace.demos.dataset import Demos
from planspace.embed.embedding import LOG, Embedding
from planspace.embed.measurement import split_of
from planspace.figures.embedding import paths_html, plot_distance_against_time, plot_paths
from planspace.figures.style import save_figure
from planspace.figures.training_curves import plot_training, read_log
from planspace.storage.checks import reject_malformed
from planspace.storage.files import make_folder, write_bytes


def draw_embedding(embedding: Embedding, folder: Path, demos: Demos, out: Path) -> None:
    """Saves paths (PNG, SVG, interactive HTML), distance against time, and the curves of the training.

    Args:
        embedding: what to draw.
        folder: its folder, where the log of its training is, if anywhere.
        demos: the demonstrations; of those it was trained on, the test split is drawn.
        out: where the figures go.

    Raises:
        PlanspaceError: a figure cannot be written, or the log makes no sense.
    """
    splits = split_of(embedding, demos)
    episodes = splits.get("test", np.arange(len(demos)))
    training = _curves(embedding, folder) if (folder / LOG).exists() else None
    make_folder(out)
    save_figure(plot_paths(embedding, demos, episodes), out, "paths")
    write_bytes(out / "paths.html", paths_html(embedding, demos, episodes).encode())
    save_figure(plot_distance_against_time(embedding, demos, episodes), out, "distance")
    if training is not None:
        save_figure(training, out, "training")


def _curves(embedding: Embedding, folder: Path) -> matplotlib.figure.Figure:
    seeds = embedding.about.get("settings", {}).get("seeds")
    kept = list(seeds).index(embedding.about["seed"]) if seeds else None
    with reject_malformed(folder / LOG):
        return plot_training(read_log(folder), kept, seeds)
