"""What a file format of demonstrations has to provide."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from planspace.demos.dataset import Demos
from planspace.demos.recording import Imported, ImportOptions
from planspace.demos.state_info import StateInfo

ReadFn = Callable[[Sequence[str], StateInfo | None, ImportOptions], Imported]
WriteFn = Callable[[Demos, str], Path]


@dataclass(frozen=True)
class Format:
    """A file format of demonstrations."""

    pattern: str
    """How a source is written, such as `FILE.npz`; shown in messages."""
    recognises: Callable[[str], bool]
    """Whether a source has this format, judged by its name only."""
    read: ReadFn
    """Read sources of this format, in the given order, as one dataset.

    The arguments are the sources, the states of the planning problem (None if there is none) and the import
    options. Options that the format cannot use are refused with `check_options`.
    """
    write: WriteFn | None = None
    """Write demonstrations to a target and return what was written. None if the format is only read."""
    is_file: bool = True
    """Whether sources are files. `load_demos` reads other sources, such as Minari, without an import."""


def has_suffix(suffix: str) -> Callable[[str], bool]:
    """A function that recognises file names by their suffix, ignoring case."""
    return lambda source: Path(source).suffix.lower() == suffix
