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
autodoc_typehints_format = "short"  # `Demos`, not the module that defines it
python_maximum_signature_line_length = 100
suppress_warnings = [
    "ref.python"
]  # a short type such as `Problem` is found under its public and its full name
autodoc_mock_imports = [] if importlib.util.find_spec("stable_baselines3") else ["stable_baselines3"]
autodoc_default_options = {"members": True}
napoleon_use_rtype = False


def as_restructured_text(app, what, name, obj, options, lines):
    """Our docstrings write `code` as Markdown does, |x| for a length, and *batch for any leading axes."""
    for i, line in enumerate(lines):
        parts = re.split(r"(`+[^`]+`+)", line)
        lines[i] = "".join(
            f"``{part.strip('`')}``" if part.startswith("`") else re.sub(r"\||\*(?=\w)", r"\\\g<0>", part)
            for part in parts
        )


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", as_restructured_text)
