"""The figures that `planspace measure --plot` saves."""

from pathlib import Path

import matplotlib.figure
import numpy as np

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.measurement import split_of
from planspace.embed.saved_embedding import LOG
from planspace.embed.training_log import read_log
from planspace.figures.distance import plot_distance_against_time
from planspace.figures.interactive_paths import MAX_INTERACTIVE, interactive_points, paths_html
from planspace.figures.paths import embedded_paths
from planspace.figures.plot_paths import plot_paths
from planspace.figures.style import save_figure
from planspace.figures.training_curves import plot_training
from planspace.storage.checks import reject_malformed
from planspace.storage.files import make_folder, write_bytes


def draw_embedding(embedding: Embedding, folder: Path, demos: Demos, out: Path) -> None:
    """Save figures of an embedding: paths in z, distance against time, and training curves.

    If the embedding was trained on these demonstrations, only the test split is drawn.

    Args:
        embedding: the embedding.
        folder: the folder of the embedding. Without a training log in it, training curves are left out.
        demos: the demonstrations to draw.
        out: the folder for the figures: `paths` (PNG, SVG, interactive HTML), `distance` and `training`.

    Raises:
        PlanspaceError: a figure cannot be written, or the log is invalid.
    """
    splits = split_of(embedding, demos)
    episodes = splits.get("test", np.arange(len(demos)))
    training = _training_figure(embedding, folder) if (folder / LOG).exists() else None
    make_folder(out)
    save_figure(plot_paths(embedded_paths(embedding, demos, episodes)), out, "paths")
    most_points = interactive_points(embedding.state_dim)
    page = paths_html(embedded_paths(embedding, demos, episodes, MAX_INTERACTIVE, most_points))
    write_bytes(out / "paths.html", page.encode())
    save_figure(plot_distance_against_time(embedding, demos, episodes), out, "distance")
    if training is not None:
        save_figure(training, out, "training")


def _training_figure(embedding: Embedding, folder: Path) -> matplotlib.figure.Figure:
    seeds = selected = None
    if embedding.about is not None:
        seeds = embedding.about.settings.seeds
        selected = seeds.index(embedding.about.seed)
    with reject_malformed(folder / LOG):
        return plot_training(read_log(folder), selected, seeds)
