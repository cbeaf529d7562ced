"""Load a dataset."""

from pathlib import Path

from planspace.demos.convert import load_source
from planspace.demos.dataset import Demos
from planspace.demos.formats.registry import find_format
from planspace.demos.stored import StoredDemos


def load_demos(path: str | Path) -> Demos:
    """Read a dataset and verify every shard.

    Args:
        path: a dataset folder; the name of ready-made plans, such as `cartpole-swingup`; or `minari:ID` for a
            Minari dataset on this machine.

    Raises:
        UsageError: neither a folder nor ready-made plans have this name.
        PlanspaceError: there is no dataset, it has a newer schema, or a shard is missing or was altered (the
            message names it).
    """
    fmt = find_format(str(path))
    if fmt is not None and not fmt.is_file:
        return load_source(str(path))
    return StoredDemos(path).load()
