"""Self-contained pages: one file with its scripts inside, which loads nothing."""

from pathlib import Path
from typing import Any

import jinja2
import plotly.graph_objects as go
import plotly.io
import plotly.offline

from planspace.figures.style import PLOTLY_CONFIG
from planspace.storage.files import write_bytes

TEMPLATES = Path(__file__).parent / "templates"


def write_page(path: Path, template: str, **content: Any) -> Path:
    """Fills a template; what is text stays text, whatever is in it.

    Args:
        path: the file.
        template: its name among the templates.
        content: what it asks for; figures as `embedded` gives them.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    html = environment.get_template(template).render(plotly=plotly.offline.get_plotlyjs(), **content)
    write_bytes(path, html.encode())
    return path


def embedded(figure: go.Figure) -> str:
    """A figure to embed in a page."""
    return plotly.io.to_html(figure, include_plotlyjs=False, full_html=False, config=PLOTLY_CONFIG)
