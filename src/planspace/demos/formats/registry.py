"""The file formats of demonstrations.

To add a format, write one file in this folder that defines a `Format`, and add it to `FORMATS`. The commands
`planspace demos import` and `export`, `load_demos` and the messages that list formats then know it: they ask
the format whether it recognises a source.

A reader of a table of named columns returns `Tables`, as `parquet.py` does; the import then finds times,
states and controls. Any other reader returns `Imported`, as `npz_mujoco.py` does, with the demonstrations one
by one where it can (`Imported.episodes` may be a generator), so that a source may be larger than memory. The
import checks each of them, makes angles continuous, resamples uneven time steps and stores the result; the
reader does not have to.
"""

from planspace.demos.formats.csv import CSV
from planspace.demos.formats.format import Format
from planspace.demos.formats.hdf5 import HDF5
from planspace.demos.formats.lerobot import LEROBOT
from planspace.demos.formats.minari import MINARI
from planspace.demos.formats.npz import NPZ
from planspace.demos.formats.parquet import PARQUET
from planspace.demos.formats.plans_2020 import PLANS_2020_JSON, PLANS_2020_OUT

FORMATS: dict[str, Format] = {
    "npz": NPZ,
    "csv": CSV,
    "minari": MINARI,
    "hdf5": HDF5,
    "lerobot": LEROBOT,
    "parquet": PARQUET,
    "plans-2020-json": PLANS_2020_JSON,
    "plans-2020-out": PLANS_2020_OUT,
}


def find_format(source: str) -> Format | None:
    """The format that recognises a source, or None."""
    return next((fmt for fmt in FORMATS.values() if fmt.recognises(source)), None)


def import_patterns() -> str:
    """The sources that can be imported, for messages."""
    return f"{', '.join(fmt.pattern for fmt in FORMATS.values())}, or a folder of files of one format"


def export_patterns() -> str:
    """The targets that can be written, for messages."""
    return " or ".join(fmt.pattern for fmt in FORMATS.values() if fmt.write)
