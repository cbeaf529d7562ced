"""The folder of shipped models and problem files; imports nothing, so that tasks can name their models."""

from pathlib import Path

ASSETS = Path(__file__).parent.parent / "assets"
"""The shipped models and problem files."""
