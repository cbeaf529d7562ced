"""The folder of shipped models and problem files. This module imports nothing, so that tasks stay light."""

from pathlib import Path

ASSETS = Path(__file__).parent.parent / "assets"
"""The shipped models and problem files."""
