"""Progress bars with the time left: a bar on a terminal or in a notebook, one line a minute in a log."""

import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol, TypeVar

from tqdm import TqdmWarning, tqdm

LOG_INTERVAL_S = 60.0
"""Seconds between two lines of a log."""
BAR = "{l_bar}{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]"
"""A bar on a terminal or in a notebook that shows no rate."""
PATIENCE_S = 2.0
"""Seconds before `progress_over` shows its bar."""
Item = TypeVar("Item")

_shown: ContextVar[bool] = ContextVar("progress_shown", default=True)


class Progress(Protocol):
    """The bar that a long stage updates."""

    def update(self, n: float = 1) -> object:
        """Add `n` finished units."""

    def set_postfix_str(self, s: str, refresh: bool = True) -> object:
        """Show a short text, such as the latest return, after the counts."""


@contextmanager
def progress_shown(verbose: bool) -> Iterator[None]:
    """Hide every progress bar inside the block unless `verbose` is set.

    Args:
        verbose: False hides the bars. True shows them, unless an enclosing block hides them.
    """
    token = _shown.set(verbose and _shown.get())
    try:
        yield
    finally:
        _shown.reset(token)


@contextmanager
def progress(
    description: str, total: int, *, done: int = 0, unit: str = "it", remaining: bool = True
) -> Iterator[Progress]:
    """Show the progress of a stage on standard error, or as a widget in a notebook.

    Args:
        description: name of the stage.
        total: number of units.
        done: number of units that an earlier run has finished.
        unit: what is counted.
        remaining: whether to show the time left, assuming that all units take equally long.

    Yields:
        The bar to update.
    """
    bar_class, options = _bar()
    if not remaining:
        options["bar_format"] = options.get("bar_format", BAR).replace("<{remaining}", "")
    with bar_class(
        desc=description,
        total=total,
        initial=done,
        unit=unit,
        unit_scale=total >= 10_000,
        disable=not _shown.get(),
        **options,
    ) as bar:
        yield bar


def progress_over(
    items: Iterable[Item], description: str, *, unit: str, total: int | None = None
) -> Iterator[Item]:
    """Iterate over items, with a bar on a terminal or in a notebook once that takes longer than two seconds.

    Args:
        items: the items.
        description: what is done with them.
        unit: what is counted.
        total: number of items, if it is known.
    """
    in_notebook = _in_notebook()
    bar_class = _notebook_bar() if in_notebook else tqdm
    disable = not (_shown.get() and (in_notebook or sys.stderr.isatty()))
    yield from bar_class(
        items, desc=description, unit=unit, total=total, delay=PATIENCE_S, disable=disable, leave=False
    )


def _bar() -> tuple[type[tqdm], dict[str, Any]]:
    """The class of bar for the place where the output goes, and its options."""
    if _in_notebook():
        return _notebook_bar(), {}
    if sys.stderr.isatty():
        return tqdm, {"file": sys.stderr, "dynamic_ncols": True, "mininterval": 0.2}
    line = "{desc}: {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]\n"
    interval = {"mininterval": LOG_INTERVAL_S, "maxinterval": LOG_INTERVAL_S}
    return tqdm, {"file": sys.stderr, "ncols": 100, "bar_format": line, **interval}


def _in_notebook() -> bool:
    """Whether this process is the kernel of a notebook (Jupyter, Colab, VS Code)."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and "IPKernelApp" in shell.config


def _notebook_bar() -> type[tqdm]:
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", TqdmWarning
        )  # ipywidgets is missing: the bar is text then, which will do
        from tqdm.auto import tqdm as notebook_tqdm

    return notebook_tqdm
