"""The report of `planspace run`: one self-contained HTML file, and its figures as files."""

import base64
from pathlib import Path

import numpy as np

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.figures.demos import plot_demos
from planspace.figures.interactive_paths import MAX_INTERACTIVE, interactive_paths, interactive_points
from planspace.figures.learning_curves import plot_curves
from planspace.figures.paths import embedded_paths
from planspace.figures.style import save_figure
from planspace.rl.learning_curve import SMOOTHING, learning_curve
from planspace.storage.arrays import Arrays
from planspace.storage.files import make_folder
from planspace.study.figures import interactive_curves, plain_layout, plot_paths
from planspace.study.html import embedded, write_page
from planspace.study.run_summary import FINAL_ITERATIONS, GEOMETRY_ROWS, RunSummary


def write_report(
    out: Path, summary: RunSummary, demos: Demos, embedding: Embedding, histories: dict[str, Arrays]
) -> Path:
    """Write `report.html` and `figures/` into a run's folder.

    Returns:
        The path of the report.
    """
    curves = {label: learning_curve(history) for label, history in histories.items()}
    folder = make_folder(out / "figures")
    demo_picture = save_figure(plot_demos(demos), folder, "demos")
    save_figure(plot_paths(demos, embedding), folder, "paths")
    save_figure(plot_curves(curves, summary.task), folder, "curves")
    return write_page(
        out / "report.html",
        "quickstart.html",
        summary=summary,
        geometry_rows=GEOMETRY_ROWS,
        final_iterations=FINAL_ITERATIONS,
        smoothing=SMOOTHING,
        units=dict(zip(demos.info.names, demos.info.units, strict=True)),
        demo_picture="data:image/png;base64," + base64.b64encode(demo_picture.read_bytes()).decode(),
        paths=embedded(
            interactive_paths(
                embedded_paths(
                    embedding,
                    demos,
                    np.arange(len(demos)),
                    MAX_INTERACTIVE,
                    interactive_points(embedding.state_dim),
                )
            ).update_layout(**plain_layout())
        ),
        curves=embedded(interactive_curves(curves)),
    )
