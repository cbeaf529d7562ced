"""`planspace demos`: the verbs for datasets of demonstrations."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg, subcommand

from planspace.cli.tables import counted, print_values

DemosFolder = Positional[Annotated[Path, arg(metavar="DEMOS", help="A dataset folder.")]]
Untrusted = Annotated[
    bool,
    arg(
        help="The model comes from someone you do not trust: read it in a separate process with limited "
        "memory and time."
    ),
]


@dataclass(frozen=True)
class Show:
    """Show what a dataset contains."""

    folder: DemosFolder
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Print the description."""
        from planspace.demos.describe import describe

        print_values(describe(self.folder), as_json=self.json)


@dataclass(frozen=True)
class Validate:
    """Check the hash of every shard and, with --replay, that the controls lead to the states."""

    folder: DemosFolder
    replay: bool = False
    """Simulate the recorded controls in plain MuJoCo and compare the states."""
    untrusted: Untrusted = False
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Print what was checked."""
        from planspace.demos.describe import validate

        found = validate(self.folder, replay_controls=self.replay, untrusted=self.untrusted)
        print_values(found, as_json=self.json)


@dataclass(frozen=True)
class Plot:
    """Draw a dataset in state space."""

    folder: DemosFolder
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for demos.png and demos.svg."""

    def __call__(self) -> None:
        """Draw and save the figure."""
        from planspace.demos.load import load_demos
        from planspace.figures.demos import plot_demos
        from planspace.figures.style import save_figure
        from planspace.storage.files import make_folder

        print(save_figure(plot_demos(load_demos(self.folder)), make_folder(self.out), "demos"))


@dataclass(frozen=True)
class Render:
    """Film the robot in its recorded states, in real time."""

    folder: DemosFolder
    out: Annotated[Path, arg(metavar="FILE.gif|FILE.mp4")]
    """The film. An MP4 needs the extra `video`."""
    episodes: Annotated[int, arg(metavar="N")] = 3
    """Number of demonstrations, starting with the first, shown one after another."""
    fps: Annotated[int, arg(metavar="N")] = 30
    """Frames per second."""
    width: Annotated[int, arg(metavar="PIXELS")] = 480
    """Width of a frame."""
    height: Annotated[int, arg(metavar="PIXELS")] = 360
    """Height of a frame."""
    camera: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: the model's first)")] = ""
    """A camera of the model. A model without cameras is shown as a whole."""
    untrusted: Untrusted = False

    def __call__(self) -> None:
        """Render and save the film."""
        from planspace.demos.load import load_demos
        from planspace.demos.render import FilmConfig, render_demos
        from planspace.mjcf.subprocess_model import check_compiles

        config = FilmConfig(self.episodes, self.fps, self.width, self.height, self.camera)
        demos = load_demos(self.folder)
        if self.untrusted:
            check_compiles(demos.info.source or "")
        render_demos(demos, self.out, config)
        print(self.out)


@dataclass(frozen=True)
class Import:
    """Make a dataset from demonstrations in another format, such as NPZ, CSV, Minari or HDF5."""

    source: Positional[Annotated[tuple[str, ...], arg(metavar="SOURCE ...", help_behavior_hint="(required)")]]
    """The demonstrations, for example FILE.npz with `states`, `controls`, `time` and `offsets`, FILE.csv with
    one demonstration or a column `episode`, FILE.hdf5 of robomimic or D4RL, or minari:ID. Several files, or a
    folder of files, make one dataset. The error for a missing source lists all formats."""
    out: Annotated[Path, arg(metavar="DIR")]
    """The dataset folder to make."""
    problem: Annotated[str, arg(metavar="PROBLEM|FILE.yaml", help_behavior_hint="(default: none)")] = ""
    """The planning problem that the states belong to. It provides names, units, angles and the model."""
    state: UseAppendAction[
        Annotated[tuple[str, ...], arg(metavar="NAME=COLUMN", help_behavior_hint="(repeatable)")]
    ] = ()
    """The column of a state; for Minari and HDF5 also NAME=INDEX or NAME=KEY[INDEX]. By default columns are
    matched by name."""
    control: UseAppendAction[
        Annotated[tuple[str, ...], arg(metavar="NAME=COLUMN", help_behavior_hint="(repeatable)")]
    ] = ()
    """The column of a control. By default control1, control2, ... (or from control0), or the actuators'
    names."""
    dt: Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint="(default: none)")] = None
    """The time step, if the source does not record it."""
    filter_key: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Import only the demonstrations that this list in the group `mask` of a robomimic file names."""
    as_recorded: bool = False
    """Keep uneven time steps and angles with full turns. Otherwise all demonstrations are resampled to one
    time step, and angles end in (-pi, pi]."""
    untrusted: bool = False
    """The model or the HDF5 file comes from someone you do not trust: read it in a separate process with
    limited memory and time."""

    def __call__(self) -> None:
        """Import and save the dataset."""
        from planspace.demos.convert import import_demos
        from planspace.demos.recording import ImportOptions, assignments
        from planspace.plan.demonstrations import state_info
        from planspace.tasks.problem_file import load_problem

        states, controls = assignments("--state", self.state), assignments("--control", self.control)
        options = ImportOptions(states, controls, self.dt, self.as_recorded, self.filter_key, self.untrusted)
        problem = load_problem(self.problem, untrusted=self.untrusted) if self.problem else None
        folder = import_demos(self.source, self.out, state_info(problem) if problem else None, options)
        print(f"{counted(folder.num_episodes, 'demonstration')} in {self.out}")


@dataclass(frozen=True)
class Export:
    """Write a dataset in a format that `demos import` reads."""

    folder: DemosFolder
    target: Positional[Annotated[str, arg(metavar="TARGET")]]
    """FILE.npz, FILE.csv, FILE.hdf5 (robomimic's layout), lerobot:DIR (a folder in LeRobot's layout), or
    minari:ID, which is stored in Minari's own folder."""

    def __call__(self) -> None:
        """Export the dataset."""
        from planspace.demos.convert import export_demos
        from planspace.demos.load import load_demos

        print(export_demos(load_demos(self.folder), self.target))


@dataclass(frozen=True)
class Demos:
    """Show, check, draw, film, import and export demonstrations."""

    action: (
        Annotated[Show, subcommand("show")]
        | Annotated[Validate, subcommand("validate")]
        | Annotated[Plot, subcommand("plot")]
        | Annotated[Render, subcommand("render")]
        | Annotated[Import, subcommand("import")]
        | Annotated[Export, subcommand("export")]
    )

    def __call__(self) -> None:
        """Run the action."""
        self.action()
