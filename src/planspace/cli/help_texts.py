"""Help texts of options: the docstring under each field, without its line breaks.

tyro reads these docstrings itself, but keeps the line breaks of indented ones, so that a text is broken in
the middle of a line. It prefers a help text in a field's metadata, where this module puts the joined text.
"""

import ast
import inspect
import textwrap
from dataclasses import fields, is_dataclass
from typing import Any, get_args

HELP = "help"


def set_help_texts(kind: Any, default: Any = None) -> None:
    """Set the help text of every field of a dataclass and of the dataclasses nested in it.

    Args:
        kind: the dataclass, or a union or annotated form of several.
        default: an instance whose fields may hold other types than they are annotated with.
    """
    if not (isinstance(kind, type) and is_dataclass(kind)):
        for part in get_args(kind):
            set_help_texts(part)
        return
    texts = _field_docstrings(kind)
    for field in fields(kind):
        value = getattr(default, field.name, field.default)
        if field.name in texts:
            negation = " This is the default; the option turns it off." if value is True else ""  # --no-NAME
            field.metadata = {**field.metadata, HELP: texts[field.name] + negation}  # pyright: ignore
        set_help_texts(type(value) if is_dataclass(value) else field.type, value)


def _field_docstrings(kind: type) -> dict[str, str]:
    """Field to the docstring that follows it in the source, joined to one line."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    except (OSError, TypeError, SyntaxError):  # defined at a prompt
        return {}
    (definition,) = tree.body
    assert isinstance(definition, ast.ClassDef)
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in zip(definition.body, definition.body[1:], strict=False)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
        if isinstance(text.value.value, str)
    }
