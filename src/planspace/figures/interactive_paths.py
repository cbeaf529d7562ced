"""Draw demonstrations as paths in z with Plotly, as a figure and as a self-contained HTML page."""

import html
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io

from planspace.figures.paths import Paths
from planspace.figures.style import END_COLOUR, PLOTLY_CONFIG

MAX_INTERACTIVE = 200
"""Recommended number of demonstrations in an interactive figure; more make it slow."""
MAX_NUMBERS = 500_000
"""Recommended number of numbers in an interactive figure; each takes about eight bytes of the page."""
CAMERA = {"eye": {"x": 1.6, "y": -1.7, "z": 0.9}, "center": {"x": 0, "y": 0, "z": -0.1}}
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'
'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; worker-src blob:">
<title>{title}</title>
<style>
  body {{ margin: 1.5rem; font: 16px/1.5 system-ui, sans-serif; color: #1c2430; background: white; }}
  h1 {{ font-size: 1.3rem; margin: 0; }} p {{ margin: 0; color: #5c6778; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>Each line is a demonstration. In a perfect plan space, each would be straight and have constant speed.
{gesture} to read the state.</p>
{picture}
</body>
</html>
"""
"""The content security policy keeps the page from loading anything."""


def paths_html(paths: Paths) -> str:
    """`interactive_paths` as an HTML page that works without other files and without a network."""
    picture = plotly.io.to_html(
        interactive_paths(paths),
        include_plotlyjs=True,
        full_html=False,
        default_height="80vh",
        config=PLOTLY_CONFIG,
    )
    gesture = "Drag to rotate, scroll to zoom, hover" if paths.is_3d else "Hover"
    return PAGE.format(title=html.escape(paths.title), gesture=gesture, picture=picture)


def interactive_points(num_columns: int) -> int:
    """Recommended number of states in an interactive figure of states with some columns."""
    return MAX_NUMBERS // (num_columns + 7)  # coordinates, colours, number, time and time left


def interactive_paths(paths: Paths) -> go.Figure:
    """Draw paths in z that can be rotated and that show the state under the pointer."""
    figure = go.Figure(_lines(paths))
    ends = [np.round(p[-1], 4).tolist() for p in paths.points]
    mark = {"size": 4 if paths.is_3d else 8, "color": END_COLOUR}
    add = figure.add_scatter3d if paths.is_3d else figure.add_scatter
    add(**_coordinates(ends), mode="markers", name="end of a demonstration", marker=mark, hoverinfo="skip")
    figure.update_layout(_layout(paths))
    return figure


def _lines(paths: Paths) -> Any:
    """All paths as one line with gaps; each point knows its demonstration, time and state."""
    gap, rows, colours, points = [None], [], [], []
    for i, number in enumerate(paths.numbers):
        left = paths.time_left(i)
        row = np.column_stack([np.full(len(left), number), paths.times[i], left, paths.states[i]])
        rows += [*np.round(row, 4).tolist(), gap * row.shape[1]]
        colours += [*np.round(left, 4).tolist(), 0.0]
        points += [*np.round(paths.points[i], 4).tolist(), gap * len(paths.labels)]
    colour = {
        "color": colours,
        "colorscale": "Viridis",
        "reversescale": True,
        "cmin": 0,
        "cmax": paths.longest,
        "colorbar": {"title": "time left [s]", "thickness": 14, "len": 0.7},
    }
    common = {
        **_coordinates(points),
        "mode": "lines+markers",
        "showlegend": False,
        "customdata": rows,
        "hovertemplate": _hover(paths),
    }
    if paths.is_3d:
        line = {key: value for key, value in colour.items() if key != "colorbar"}
        return go.Scatter3d(**common, line={**line, "width": 4}, marker={**colour, "size": 2})
    return go.Scatter(**common, line={"color": "#c5ccd6", "width": 1}, marker={**colour, "size": 5})


def _hover(paths: Paths) -> str:
    """Template of the text under the pointer."""
    states = [
        f"{_plain(name)} %{{customdata[{k}]:.3f}} {_plain(unit)}"
        for k, (name, unit) in enumerate(zip(paths.info.names, paths.info.units, strict=True), start=3)
    ]
    time = "%{customdata[1]:.2f} s, %{customdata[2]:.2f} s left"
    return "<br>".join(["demonstration %{customdata[0]}", time, *states]) + "<extra></extra>"


def _layout(paths: Paths) -> dict[str, Any]:
    grid: dict[str, Any] = {"gridcolor": "#d9dee6", "zerolinecolor": "#d9dee6"}
    if paths.is_3d:
        grid |= {"showbackground": False, "nticks": 6}
    axes: dict[str, Any] = {
        f"{name}axis": {"title": {"text": label}, **grid}
        for name, label in zip("xyz", paths.labels, strict=False)
    }
    if paths.is_3d:
        axes = {"scene": {**axes, "aspectmode": "data", "camera": CAMERA}}
    elif not paths.against_time:
        axes["yaxis"]["scaleanchor"] = "x"
    return {
        **axes,
        "plot_bgcolor": "white",
        "font": {"family": "system-ui, sans-serif", "size": 13},
        "margin": {"l": 60, "r": 20, "t": 40, "b": 50},
        "legend": {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"},
    }


def _coordinates(points: Sequence[Sequence[float | None]]) -> dict[str, Any]:
    return dict(zip("xyz", zip(*points, strict=True), strict=False))


def _plain(text: str) -> str:
    """Escape text so that Plotly shows it literally."""
    return "".join(c if c.isalnum() or c in " _-/.^" else f"&#{ord(c)};" for c in text)
