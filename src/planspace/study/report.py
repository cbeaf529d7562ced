"""The report: one HTML file that needs nothing beside it, and the figures as files."""

import base64
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import plotly.graph_objects as go
import plotly.io
import plotly.offline

from planspace.demos.dataset import Demos
from planspace.demos.plot import plot_demos
from planspace.embed.embedding import Embedding
from planspace.embed.plot import PLOTLY_CONFIG, interactive_paths
from planspace.figure import save_figure
from planspace.rl.curves import SMOOTHING, learning_curve, plot_curves
from planspace.store import Arrays, make_folder, write_bytes
from planspace.study.figures import interactive_curves, plain_layout, plot_paths

TEMPLATES = Path(__file__).parent / "templates"

FINAL_ITERATIONS = 10
"""The closing table averages each seed's return over this many last iterations."""
GEOMETRY_ROWS = (
    ("straightness", "straightness", "1 is a straight line"),
    ("speed_variation", "speed variation", "0 is constant speed"),
    ("midpoint_error", "midpoint error", "0 is even spacing on a line"),
    ("time_correlation", "time correlation", "1: distance to the end orders the time left"),
    ("effective_rank", "effective rank", "dimensions in use"),
    ("decoded_error", "decoded error", "of the state read back from z, in deviations"),
)


def write_report(
    out: Path, summary: dict[str, Any], demos: Demos, embedding: Embedding, histories: dict[str, Arrays]
) -> Path:
    """Writes `report.html` and `figures/` into a run's folder.

    Returns:
        The report's path.
    """
    curves = {label: learning_curve(history) for label, history in histories.items()}
    folder = make_folder(out / "figures")
    demo_picture = save_figure(plot_demos(demos), folder, "demos")
    save_figure(plot_paths(demos, embedding), folder, "paths")
    save_figure(plot_curves(curves, summary["task"]), folder, "curves")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    html = environment.get_template("report.html").render(
        summary=summary,
        geometry_rows=GEOMETRY_ROWS,
        final_iterations=FINAL_ITERATIONS,
        smoothing=SMOOTHING,
        units=dict(zip(demos.info.names, demos.info.units, strict=True)),
        demo_picture="data:image/png;base64," + base64.b64encode(demo_picture.read_bytes()).decode(),
        paths=_html(
            interactive_paths(embedding, demos, np.arange(len(demos))).update_layout(**plain_layout())
        ),
        curves=_html(interactive_curves(curves)),
        plotly=plotly.offline.get_plotlyjs(),
    )
    path = out / "report.html"
    write_bytes(path, html.encode())
    return path


def _html(figure: go.Figure) -> str:
    return plotly.io.to_html(figure, include_plotlyjs=False, full_html=False, config=PLOTLY_CONFIG)
