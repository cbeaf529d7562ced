"""Self-contained HTML pages: scripts are inside the file, and nothing is loaded."""

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
    """Fill a template and write the page. Texts are escaped.

    Args:
        path: the file to write.
        template: name of the template.
        content: variables of the template. Figures are HTML from `embedded`.

    Returns:
        `path`.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    html = environment.get_template(template).render(plotly=plotly.offline.get_plotlyjs(), **content)
    write_bytes(path, html.encode())
    return path


def embedded(figure: go.Figure) -> str:
    """Convert a figure to HTML for a page."""
    return plotly.io.to_html(figure, include_plotlyjs=False, full_html=False, config=PLOTLY_CONFIG)
