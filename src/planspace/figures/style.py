"""Colours, settings and file output shared by all figures."""

import io
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.cm
import matplotlib.colors
import matplotlib.figure

from planspace.storage.files import write_bytes

COLOURS = ("#4477aa", "#228833", "#ee7733", "#aa3377", "#66ccee", "#bbbb33", "#775533", "#888888")
"""Colours that colour-blind readers can tell apart (after Paul Tol)."""
COLOURMAP = "viridis_r"
"""Colour map for the time left in a demonstration."""
END_COLOUR = "crimson"
"""Colour of the point where a demonstration ends."""
MAX_VECTOR = 20_000
"""With more line segments than this, the lines in an SVG file are stored as pixels, which keeps it small."""
PLOTLY_CONFIG: dict[str, Any] = {
    "displaylogo": False,
    "responsive": True,
    "scrollZoom": True,
    "showSendToCloud": False,
}
"""Plotly 7 shows a button that uploads the data to its maker unless `showSendToCloud` is off."""


def time_left_scale(longest: float) -> matplotlib.cm.ScalarMappable:
    """The colour scale of the time left [s], from 0 to `longest`."""
    return matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(0, longest), COLOURMAP)


def save_figure(figure: matplotlib.figure.Figure, folder: Path, name: str) -> Path:
    """Save a figure as PNG and SVG and return the path of the PNG.

    The same figure always gives the same bytes.
    """
    for ending in ("svg", "png"):
        buffer = io.BytesIO()
        with matplotlib.rc_context({"svg.hashsalt": name}):
            figure.savefig(buffer, format=ending, dpi=150, metadata={"Date": None} if ending == "svg" else {})
        write_bytes(folder / f"{name}.{ending}", buffer.getvalue())
    return folder / f"{name}.png"
