"""Sphinx's settings: `sphinx-build docs docs/_build` (extra `docs`)."""

import importlib.util
import re

import planspace

project = "planspace"
version = release = planspace.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"planspace {release}"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say shapes and units
autodoc_mock_imports = [] if importlib.util.find_spec("stable_baselines3") else ["stable_baselines3"]
autodoc_default_options = {"members": True}
napoleon_use_rtype = False


def as_restructured_text(app, what, name, obj, options, lines):
    """Our docstrings write `code` as Markdown does, and |x| for a length."""
    for i, line in enumerate(lines):
        parts = re.split(r"(`+[^`]+`+)", line)
        lines[i] = "".join(
            f"``{part.strip('`')}``" if part.startswith("`") else part.replace("|", "\\|") for part in parts
        )


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", as_restructured_text)
