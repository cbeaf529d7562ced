"""What a file format of demonstrations has to provide.

A reader returns one of two things:

- `Tables`, if the file has named columns of numbers (CSV, Parquet, arrays with names). The reader passes on
  what the file says: names, units, kinds, the time step. The rest is done once for all formats, in
  `planspace.demos.tables`: options such as `--time`, `--episode`, `--state` and `--control`, guesses from
  names, grouping rows into demonstrations, and times.
- `Imported`, if the format itself determines what its states are (a model, the states of a simulator).

`planspace.demos.convert` then cleans, checks, resamples and stores the demonstrations of both.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.recording import Imported, ImportOptions
from planspace.demos.state_info import StateInfo

Kind = Literal["time", "episode", "split", "state", "control", "unused"]
"""What a column contains. `unused` is never a state unless the user names it: counters, rewards, texts."""


@dataclass(frozen=True)
class Column:
    """A column of a table, with what the file says about it."""

    name: str
    unit: str = ""
    """Its unit; empty if the file does not say it."""
    kind: Kind | None = None
    """What the file says it contains; None leaves it to the options and to a guess by its name."""


class Rows(Protocol):
    """Consecutive rows of a table; a few thousand at a time are good.

    `NumberRows` is the implementation for rows that are already numbers.
    """

    @property
    def lines(self) -> Int[np.ndarray, " row"]:
        """Number of each row in the file, as messages show it."""
        ...

    def numbers(self, columns: Sequence[int]) -> Float[np.ndarray, "row column"]:
        """The numbers in some columns; NaN where a cell is empty.

        Raises:
            PlanspaceError: a cell contains something else; the message names the file, row and column.
        """
        ...

    def labels(self, column: int) -> Sequence[str]:
        """The cells of a column as text, such as names of demonstrations."""
        ...


@dataclass(frozen=True)
class NumberRows:
    """Rows that are numbers."""

    lines: Int[np.ndarray, " row"]
    values: Float[np.ndarray, "row column"]

    def numbers(self, columns: Sequence[int]) -> Float[np.ndarray, "row column"]:
        """The numbers in some columns."""
        return self.values[:, list(columns)]

    def labels(self, column: int) -> Sequence[str]:
        """The numbers in a column as text; integers without a decimal point."""
        return [f"{x:.17g}" for x in self.values[:, column].tolist()]


@dataclass(frozen=True)
class Table:
    """A table in a file. Without a column of the kind `episode` it is one demonstration."""

    file: str
    """The file, for messages."""
    columns: tuple[Column, ...]
    """All columns, in the order of the file."""
    rows: Callable[[], Iterator[Rows]]
    """Read the table from its start; called more than once."""
    word: str = "row"
    """What messages call a row: `line` in a text file."""


@dataclass(frozen=True)
class Tables:
    """The content of a source as tables with the same columns."""

    tables: Sequence[Table]
    """At least one table. The demonstrations are numbered in this order."""
    step: float | None = None
    """Time between rows [s], if the file says it (`1 / fps`). A column of times has precedence."""
    notices: tuple[str, ...] = ()
    """What the reader assumed, one line each."""
    splits: Mapping[str, Sequence[int]] = field(default_factory=dict)
    """Numbers of the demonstrations in each split that the file names, such as `train`; may be empty."""


ReadFn = Callable[[Sequence[str], StateInfo | None, ImportOptions], Imported | Tables]
WriteFn = Callable[[Demos, str], Path]


@dataclass(frozen=True)
class Format:
    """A file format of demonstrations."""

    pattern: str
    """How a source is written, such as `FILE.npz`; shown in messages."""
    recognises: Callable[[str], bool]
    """Whether a source has this format, judged by its name or by the names of the files in a folder."""
    read: ReadFn
    """Read sources of this format, in the given order, as one dataset.

    The arguments are the sources, the states of the planning problem (None if there is none) and the import
    options. A reader of `Imported` refuses options that it cannot use with `check_options`; a reader of
    `Tables` ignores the options that choose columns and times, because the import uses them.
    """
    write: WriteFn | None = None
    """Write demonstrations to a target and return what was written. None if the format is only read."""
    is_file: bool = True
    """Whether sources are files. `load_demos` reads other sources, such as Minari, without an import."""


def has_suffix(suffix: str) -> Callable[[str], bool]:
    """A function that recognises file names by their suffix, ignoring case."""
    return lambda source: Path(source).suffix.lower() == suffix
