"""`planspace demos import`: a dataset from demonstrations in another format."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from planspace.cli.tables import counted
from planspace.errors import UsageError, printable

if TYPE_CHECKING:
    from planspace.demos.state_info import StateInfo

Names = UseAppendAction[Annotated[tuple[str, ...], arg(metavar="NAME", help_behavior_hint="(repeatable)")]]
Assignments = UseAppendAction[
    Annotated[tuple[str, ...], arg(metavar="NAME=COLUMN", help_behavior_hint="(repeatable)")]
]


@dataclass(frozen=True)
class Import:
    """Make a dataset from demonstrations in another format, such as NPZ, CSV, Minari or HDF5.

    A table shows what every column of the source is used for, before anything is written.
    """

    source: Positional[Annotated[tuple[str, ...], arg(metavar="SOURCE ...", help_behavior_hint="(required)")]]
    """The demonstrations, for example FILE.npz with `states`, `controls`, `time` and `offsets`, FILE.csv with
    one demonstration or a column `episode`, FILE.hdf5 of robomimic or D4RL, a LeRobot folder, or
    minari:ID. Several files, or a folder of files, make one dataset. The error for a missing source lists all
    formats."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(required without --dry-run)")] = None
    """The dataset folder to make."""
    dry_run: bool = False
    """Read and check everything, print the table of columns, and write nothing."""
    problem: Annotated[str, arg(metavar="PROBLEM|FILE.yaml", help_behavior_hint="(default: none)")] = ""
    """The planning problem that the states belong to. It provides names, units, angles and the model."""
    model: Annotated[Path | None, arg(metavar="FILE.xml", help_behavior_hint="(default: none)")] = None
    """The MuJoCo model that the states were recorded from, instead of a problem. A state has the positions
    and velocities of all joints."""
    state: Assignments = ()
    """The column of a state, by its name or, counted from 0, by its number; for Minari and HDF5 also
    NAME=INDEX or NAME=KEY[INDEX]. By default columns are matched by name."""
    control: Assignments = ()
    """The column of a control. By default control1, control2, ... (or from control0), action0, ..., or the
    actuators' names."""
    time: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: by name)")] = ""
    """The column with the time, such as `timestamp`. `--unit NAME=ms` says its unit; otherwise it is seconds,
    or what a clock that counts since 1970 has."""
    dt: Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint="(default: none)")] = None
    """The time step, if the source does not record it. Columns of times are not used then."""
    episode: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: by name)")] = ""
    """The column that tells demonstrations apart, such as `episode_index`. If you name the time or a counter
    of frames, a demonstration begins wherever it goes back."""
    circular: Names = ()
    """A state that is an angle on a circle. It is made continuous before anything is interpolated, and an
    embedding sees its sine and cosine. Guessed from names (yaw, heading) and from jumps by a full turn."""
    linear: Names = ()
    """A state that is not an angle on a circle, whatever its name or values suggest."""
    quaternion: UseAppendAction[
        Annotated[tuple[str, ...], arg(metavar="FIRST:LAST[:xyzw]", help_behavior_hint="(repeatable)")]
    ] = ()
    """Four neighbouring states that are a unit quaternion, in the order w, x, y, z or, with `:xyzw`, x, y, z,
    w: `--quaternion qx:qw:xyzw`. They are stored as w, x, y, z."""
    unit: UseAppendAction[
        Annotated[tuple[str, ...], arg(metavar="NAME=UNIT", help_behavior_hint="(repeatable)")]
    ] = ()
    """The unit of a column. Angles on a circle in `deg` or `turn` are converted to radians. With a problem or
    a model, all states are converted to its units."""
    drop: Names = ()
    """A column to leave out."""
    keep: Names = ()
    """A column that is a state although its name suggests a time, a counter or an outcome."""
    rate: Annotated[float | None, arg(metavar="HZ", help_behavior_hint="(default: all states)")] = None
    """Thin the demonstrations to this many states per second."""
    gaps: Literal["refuse", "split", "fill"] = "refuse"
    """What to do where rows are missing: refuse the source, cut the demonstration there, or interpolate."""
    split: Annotated[str, arg(metavar="FILE.json|NAME", help_behavior_hint="(default: at random)")] = ""
    """The training, validation and test demonstrations: a JSON file such as `{"train": [0, 1], "test": [2]}`,
    a column with the name of the split, or `source` for the lists that the source names (robomimic, LeRobot).
    Demonstrations in none of them are not used; a split that is not named is drawn from the training."""
    filter_key: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Import only the demonstrations that this list in the group `mask` of a robomimic file names."""
    as_recorded: bool = False
    """Keep uneven time steps and angles with full turns. Otherwise all demonstrations are resampled to one
    time step, and angles end in (-pi, pi]."""
    untrusted: bool = False
    """The model, HDF5 file or LeRobot folder comes from someone you do not trust: read it in a separate
    process with limited memory and time."""

    def __call__(self) -> None:
        """Import and save the dataset, or show what would be imported."""
        from planspace.demos.convert import import_demos, preview
        from planspace.demos.recording import ImportOptions, assignments

        if self.out is None and not self.dry_run:
            raise UsageError("give the dataset folder to make, --out DIR, or --dry-run.")
        options = ImportOptions(
            states=assignments("--state", self.state),
            controls=assignments("--control", self.control),
            units=assignments("--unit", self.unit, "UNIT"),
            quaternions=self.quaternion,
            **{name: getattr(self, name) for name in PASSED_ON},
        )
        info = self._states()
        if self.dry_run or self.out is None:
            table, num = preview(self.source, info, options)
            print(table)
            print(f"{counted(num, 'demonstration')}; nothing is written")
            return
        folder = import_demos(self.source, self.out, info, options, show=_show)
        print(f"{counted(folder.num_episodes, 'demonstration')} in {self.out}")

    def _states(self) -> "StateInfo | None":
        """The states of the problem or the model; None if there is neither."""
        from planspace.demos.formats.recorded_model import model_states
        from planspace.plan.demonstrations import state_info
        from planspace.tasks.problem_file import load_problem

        if self.problem and self.model:
            raise UsageError("--problem has a model already; leave --model out.")
        if self.model:
            return model_states(self.model, untrusted=self.untrusted)
        return state_info(load_problem(self.problem, untrusted=self.untrusted)) if self.problem else None


PASSED_ON = (
    "time", "dt", "episode", "circular", "linear", "drop", "keep", "rate", "gaps", "split", "filter_key",
    "as_recorded", "untrusted",
)  # fmt: skip
"""Options that have the same name in `ImportOptions`."""


def _show(table: str) -> None:
    print("\n".join(map(printable, table.splitlines())), file=sys.stderr)
