"""Draw what controllers did beside the plans that their embedding was trained on, with Plotly."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding, norm
from planspace.figures.projection import principal_components
from planspace.figures.style import COLOURS
from planspace.figures.thinning import thin_paths

CAMERA = {"eye": {"x": 1.7, "y": -1.8, "z": 0.9}, "center": {"x": 0, "y": 0, "z": -0.15}}
MAX_POINTS = 20_000
"""About this many points of a group of paths are drawn."""
PLAN_COLOUR = "#b4bcc8"
PLANS = "plan"
"""Name of the group that is drawn in grey; every other group is drawn in a colour, with its ends."""


@dataclass(frozen=True)
class PlotSpace:
    """What paths are drawn in: z, or the standardised states that the encoder reads."""

    name: str
    """`z` or `the standardised state`."""
    axis: str
    """Name of a coordinate, without its number."""
    columns: tuple[int, ...]
    """Columns of a state that the embedding reads."""
    points: Callable[[np.ndarray], np.ndarray]
    """States [time, state] to points [time, axis]."""

    @classmethod
    def z(cls, embedding: Embedding, demos: Demos) -> "PlotSpace":
        """The space of z, for states with the names of these demonstrations."""
        return cls("z", "z", embedding.columns_of(demos.info.names), embedding.encode)

    @classmethod
    def raw(cls, embedding: Embedding, demos: Demos) -> "PlotSpace":
        """The space of the standardised states, for states with the names of these demonstrations."""
        return cls(
            "the standardised state", "input ", embedding.columns_of(demos.info.names), embedding.inputs
        )

    def of(self, states: np.ndarray) -> np.ndarray:
        """Points of states [..., state]."""
        return self.points(states[..., list(self.columns)])


def draw_paths(space: PlotSpace, groups: Mapping[str, Demos]) -> go.Figure:
    """Draw groups of episodes as paths.

    A space with more than three dimensions is drawn in its first three principal components.

    Args:
        space: what they are drawn in.
        groups: the episodes by the name in the legend, the front ones first; `PLANS` is grey.
    """
    encoded = {
        name: [space.of(demos.episode(i).states) for i in range(len(demos))] for name, demos in groups.items()
    }
    points = np.concatenate([path for paths in encoded.values() for path in paths])
    labels = [f"{space.axis}{k + 1}" for k in range(points.shape[1])]
    if len(labels) > 3:
        points, _ = principal_components(points, 3)
        labels = [f"component {k + 1}" for k in range(3)]
    figure = go.Figure()
    taken = 0
    for (name, paths), colour in zip(encoded.items(), _colours(groups), strict=True):
        lengths = [len(path) for path in paths]
        drawn = np.split(points[taken : taken + sum(lengths)], np.cumsum(lengths)[:-1])
        taken += sum(lengths)
        _add_lines(figure, drawn, name, colour)
        if name != PLANS:
            _add_ends(figure, [path[-1] for path in drawn], name, colour)
    axes = {f"{axis}axis": {"title": {"text": label}} for axis, label in zip("xyz", labels, strict=False)}
    scene = {**axes, "aspectmode": "data", "camera": CAMERA}
    layout: dict[str, Any] = {"scene": scene} if len(labels) == 3 else axes
    figure.update_layout(**layout)
    return figure


def draw_distances(space: PlotSpace, groups: Mapping[str, Demos]) -> go.Figure:
    """Draw the distance to the goal against the time since the start.

    Args:
        space: what distances are measured in.
        groups: the episodes by the name in the legend, the front ones first; `PLANS` is grey.
    """
    figure = go.Figure()
    for (name, demos), colour in reversed(list(zip(groups.items(), _colours(groups), strict=True))):
        curves = []
        for i in range(len(demos)):
            episode = demos.episode(i)
            away = norm(space.of(episode.states) - space.of(episode.goal))
            curves.append(np.column_stack([episode.times, away]))
        _add_lines(figure, curves, name, colour)
    figure.update_layout(
        xaxis_title="time [s]",
        yaxis_title=f"distance in {space.name}",
        yaxis_rangemode="tozero",
        legend_traceorder="reversed",
    )
    return figure


def _colours(groups: Mapping[str, Demos]) -> list[str]:
    coloured = [name for name in groups if name != PLANS]
    return [PLAN_COLOUR if name == PLANS else COLOURS[coloured.index(name)] for name in groups]


def _add_lines(figure: go.Figure, paths: Sequence[np.ndarray], name: str, colour: str) -> None:
    """Add all paths as one line with gaps; long paths without some of their points."""
    paths = [path[rows] for path, rows in zip(paths, thin_paths(paths, MAX_POINTS), strict=True)]
    gap = np.full((1, paths[0].shape[1]), np.nan)
    whole = np.concatenate([part for path in paths for part in (np.round(path, 4), gap)])
    columns = dict(
        zip("xyz", ([None if np.isnan(x) else x for x in column] for column in whole.T), strict=False)
    )
    add = figure.add_scatter3d if len(columns) == 3 else figure.add_scatter
    add(
        **columns,
        mode="lines",
        name=name,
        legendgroup=name,
        line={"color": colour, "width": 3 if len(columns) == 3 else 1.5},
    )


def _add_ends(figure: go.Figure, ends: Sequence[np.ndarray], name: str, colour: str) -> None:
    columns = dict(zip("xyz", np.round(np.stack(ends), 4).T.tolist(), strict=False))
    mark = {"size": 4 if len(columns) == 3 else 8, "color": colour}
    add = figure.add_scatter3d if len(columns) == 3 else figure.add_scatter
    add(**columns, mode="markers", name=name, legendgroup=name, showlegend=False, marker=mark)
