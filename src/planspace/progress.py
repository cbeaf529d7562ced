"""Progress with the time left: a bar on a terminal, one line a minute in a log."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

from tqdm import tqdm

LOG_INTERVAL_S = 60.0
PATIENCE_S = 2.0
Item = TypeVar("Item")


class Progress(Protocol):
    """What a long stage reports to."""

    def update(self, n: float = 1) -> object:
        """Says that `n` more units are done."""

    def set_postfix_str(self, s: str, refresh: bool = True) -> object:
        """Shows a short text, such as the latest return, behind the counts."""


@contextmanager
def progress(description: str, total: int, *, done: int = 0, unit: str = "it") -> Iterator[Progress]:
    """Shows how far a stage has come, on standard error.

    Args:
        description: the stage's name.
        total: how many units there are.
        done: how many of them an earlier run has finished.
        unit: what is counted.

    Yields:
        The bar to update.
    """
    on_terminal = sys.stderr.isatty()
    with tqdm(
        desc=description,
        total=total,
        initial=done,
        unit=unit,
        unit_scale=total >= 10_000,
        file=sys.stderr,
        dynamic_ncols=on_terminal,
        ncols=None if on_terminal else 100,
        mininterval=0.2 if on_terminal else LOG_INTERVAL_S,
        maxinterval=10.0 if on_terminal else LOG_INTERVAL_S,
        bar_format=None if on_terminal else "{desc}: {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]\n",
    ) as bar:
        yield bar


def shown(items: Iterable[Item], description: str, *, unit: str, total: int | None = None) -> Iterator[Item]:
    """Items as they come, counted on a terminal once that takes longer than two seconds.

    Args:
        items: what is gone through.
        description: what is done with them.
        unit: what is counted.
        total: how many there are, where that is known.
    """
    quiet = not sys.stderr.isatty()
    yield from tqdm(
        items, desc=description, unit=unit, total=total, delay=PATIENCE_S, disable=quiet, leave=False
    )
