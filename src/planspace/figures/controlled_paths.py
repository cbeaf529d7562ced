"""Draw what a controller did beside the plans that its embedding was trained on, with Plotly."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.figures.projection import principal_components
from planspace.figures.style import COLOURS, END_COLOUR
from planspace.figures.thinning import thin_paths

MAX_POINTS = 20_000
"""About this many points of a group of paths are drawn."""
PLAN_COLOUR = "#b4bcc8"
CONTROLLED, PLANNED = "controlled episode", "plan"


def paths_beside_plans(embedding: Embedding, controlled: Demos, plans: Demos | None) -> go.Figure:
    """Draw episodes and plans as paths in z.

    A z with more than three dimensions is drawn in its first three principal components.

    Args:
        embedding: the embedding.
        controlled: the controlled episodes.
        plans: plans to draw in grey; None for none.
    """
    groups = [_encoded(embedding, demos) for demos in (controlled, plans) if demos is not None]
    points = np.concatenate([z for group in groups for z in group])
    labels = [f"z{k + 1}" for k in range(embedding.z_dim)]
    if embedding.z_dim > 3:
        points, _ = principal_components(points, 3)
        labels = [f"component {k + 1} of z" for k in range(3)]
    figure = go.Figure()
    taken = 0
    for group, name, colour in zip(groups, (CONTROLLED, PLANNED), (COLOURS[0], PLAN_COLOUR), strict=False):
        lengths = [len(z) for z in group]
        paths = np.split(points[taken : taken + sum(lengths)], np.cumsum(lengths)[:-1])
        taken += sum(lengths)
        _add_lines(figure, paths, name, colour)
        if name == CONTROLLED:
            _add_ends(figure, [path[-1] for path in paths])
    axes = {f"{axis}axis": {"title": {"text": label}} for axis, label in zip("xyz", labels, strict=False)}
    layout: dict[str, Any] = {"scene": {**axes, "aspectmode": "data"}} if len(labels) == 3 else axes
    figure.update_layout(**layout)
    return figure


def distance_beside_plans(embedding: Embedding, controlled: Demos, plans: Demos | None) -> go.Figure:
    """Draw the distance to the goal in z against the time since the start.

    Args:
        embedding: the embedding.
        controlled: the controlled episodes.
        plans: plans to draw in grey; None for none.
    """
    figure = go.Figure()
    for demos, name, colour in ((plans, PLANNED, PLAN_COLOUR), (controlled, CONTROLLED, COLOURS[0])):
        if demos is not None:
            columns = list(embedding.columns_of(demos.info.names))
            curves = []
            for i in range(len(demos)):
                episode = demos.episode(i)
                away = embedding.distance(episode.states[:, columns], episode.goal[columns])
                curves.append(np.column_stack([episode.times, away]))
            _add_lines(figure, curves, name, colour)
    figure.update_layout(
        xaxis_title="time [s]", yaxis_title="distance to the goal in z", yaxis_rangemode="tozero"
    )
    return figure


def _encoded(embedding: Embedding, demos: Demos) -> list[Float[np.ndarray, "time z"]]:
    columns = list(embedding.columns_of(demos.info.names))
    return [embedding.encode(demos.episode(i).states[:, columns]) for i in range(len(demos))]


def _add_lines(figure: go.Figure, paths: Sequence[np.ndarray], name: str, colour: str) -> None:
    """Add all paths as one line with gaps; long paths without some of their points."""
    paths = [path[rows] for path, rows in zip(paths, thin_paths(paths, MAX_POINTS), strict=True)]
    gap = np.full((1, paths[0].shape[1]), np.nan)
    whole = np.concatenate([part for path in paths for part in (np.round(path, 4), gap)])
    columns = dict(
        zip("xyz", ([None if np.isnan(x) else x for x in column] for column in whole.T), strict=False)
    )
    add = figure.add_scatter3d if len(columns) == 3 else figure.add_scatter
    add(**columns, mode="lines", name=name, line={"color": colour, "width": 3 if len(columns) == 3 else 1.5})


def _add_ends(figure: go.Figure, ends: Sequence[np.ndarray]) -> None:
    columns = dict(zip("xyz", np.round(np.stack(ends), 4).T.tolist(), strict=False))
    mark = {"size": 4 if len(columns) == 3 else 8, "color": END_COLOUR}
    add = figure.add_scatter3d if len(columns) == 3 else figure.add_scatter
    add(**columns, mode="markers", name="end of an episode", marker=mark)
