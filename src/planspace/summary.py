"""Short summaries of objects, as text for a terminal and as an HTML table for notebooks."""

import html
from collections.abc import Mapping


def text_summary(title: str, rows: Mapping[str, str]) -> str:
    """A title and one line per row; rows without a value are left out."""
    width = max(map(len, rows), default=0)
    lines = [f"  {name:<{width}}  {value}" for name, value in rows.items() if value]
    return "\n".join([title, *lines])


def html_summary(title: str, rows: Mapping[str, str]) -> str:
    """The same as an HTML table."""
    cells = (
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>"
        for name, value in rows.items()
        if value
    )
    return f"<table><caption>{html.escape(title)}</caption>{''.join(cells)}</table>"
