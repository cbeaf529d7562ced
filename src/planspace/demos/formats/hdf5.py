"""HDF5 files (extra `data`) in the layout of robomimic and robosuite, or of D4RL.

The layout is recognised by the content of a file.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from planspace.demos.formats.d4rl import read_d4rl
from planspace.demos.formats.format import Format
from planspace.demos.formats.hdf5_file import hdf5_module, open_hdf5
from planspace.demos.formats.reader_subprocess import read_in_subprocess
from planspace.demos.formats.robomimic import read_robomimic
from planspace.demos.formats.robomimic_export import write_robomimic
from planspace.demos.recording import Imported, ImportOptions, check_options, source_name
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, quoted

SUFFIXES = (".hdf5", ".h5")
MAX_NAMES = 8
"""Number of groups that a message lists."""


class Layout(NamedTuple):
    """A layout of HDF5 files."""

    name: str
    fits: Callable[[dict[str, bool]], bool]
    """Whether a file has the layout, given the names at its top and whether each is a group."""
    read: Callable[[Sequence[str], StateInfo | None, ImportOptions], Imported]
    contents: str
    """What it contains, for messages."""


LAYOUTS = (
    Layout("robomimic", lambda top: top.get("data", False), read_robomimic, "the groups data/demo_0, ..."),
    Layout(
        "D4RL",
        lambda top: top.get("observations") is False and top.get("actions") is False,
        read_d4rl,
        "the arrays observations, actions, terminals and timeouts",
    ),
)


def read_hdf5(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read HDF5 files that all have the same layout.

    Args:
        sources: at least one file.
        info: the states of the planning problem; None if there is no problem.
        options: see the function that reads the layout.

    Raises:
        UsageError: an option does not fit the layout.
        PlanspaceError: a file cannot be read or has an unknown layout, or the layouts differ.
    """
    check_options(options, source_name(sources), "state", "dt", "filter-key")
    if options.untrusted:
        return read_in_subprocess("hdf5", sources, info, options)
    layouts = {find_layout(Path(source)) for source in sources}
    if len(layouts) > 1:
        names = " and ".join(sorted(layout.name for layout in layouts))
        raise PlanspaceError(f"{source_name(sources)} are {names} files; import one layout at a time.")
    return layouts.pop().read(sources, info, options)


def find_layout(file: Path) -> Layout:
    """Find the layout of an HDF5 file by its content.

    Raises:
        PlanspaceError: the file cannot be read, or has another layout; the message lists what it contains.
    """
    with open_hdf5(file) as opened:
        group = hdf5_module().Group
        top = {str(name): isinstance(opened[name], group) for name in opened}  # bytes if it is not UTF-8
    for layout in LAYOUTS:
        if layout.fits(top):
            return layout
    names = [quoted(name) for name in sorted(top)]
    found = ", ".join([*names[:MAX_NAMES], *(["..."] if len(names) > MAX_NAMES else [])]) or "nothing"
    expected = "; or ".join(f"{layout.name} has {layout.contents}" for layout in LAYOUTS)
    raise PlanspaceError(f"{file} has an unknown layout: it contains {found}. Known: {expected}.")


HDF5 = Format(
    "FILE.hdf5",
    lambda source: Path(source).suffix.lower() in SUFFIXES,
    read_hdf5,
    write_robomimic,
)
