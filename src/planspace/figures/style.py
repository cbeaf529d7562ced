"""What all figures share."""

import io
from pathlib import Path

import matplotlib
import matplotlib.figure

from planspace.storage.files import write_bytes

COLOURS = ("#4477aa", "#228833", "#ee7733", "#aa3377", "#66ccee", "#bbbb33", "#775533", "#888888")
"""Told apart by colour-blind readers (after Paul Tol)."""


def save_figure(figure: matplotlib.figure.Figure, folder: Path, name: str) -> Path:
    """Saves a figure as PNG and SVG, the same bytes for the same figure; returns the PNG's path."""
    for ending in ("svg", "png"):
        buffer = io.BytesIO()
        with matplotlib.rc_context({"svg.hashsalt": name}):
            figure.savefig(buffer, format=ending, dpi=150, metadata={"Date": None} if ending == "svg" else {})
        write_bytes(folder / f"{name}.{ending}", buffer.getvalue())
    return folder / f"{name}.png"
