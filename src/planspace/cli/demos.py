"""`planspace demos`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg, subcommand

from planspace.cli.tables import print_values


@dataclass(frozen=True)
class DemosShow:
    """Say what a dataset holds."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder."""
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Prints it."""
        from planspace.demos.describe import describe

        print_values(describe(self.folder), as_json=self.json)


@dataclass(frozen=True)
class DemosValidate:
    """Check every shard's hash, and that the recorded controls lead to the recorded states."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder."""
    replay: bool = False
    """Roll the controls out in plain MuJoCo and compare."""
    untrusted: bool = False
    """Its model comes from strangers: try it first in a process of its own, in bounded memory and time."""
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Prints what was checked."""
        from planspace.demos.describe import validate

        found = validate(self.folder, replay_controls=self.replay, untrusted=self.untrusted)
        print_values(found, as_json=self.json)


@dataclass(frozen=True)
class DemosPlot:
    """Draw a dataset in state space."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Where demos.png and demos.svg go."""

    def __call__(self) -> None:
        """Draws it."""
        from planspace.demos.folder import load_demos
        from planspace.figures.demos import plot_demos
        from planspace.figures.style import save_figure
        from planspace.storage.files import make_folder

        print(save_figure(plot_demos(load_demos(self.folder)), make_folder(self.out), "demos"))


@dataclass(frozen=True)
class DemosRender:
    """Film the robot in its recorded states, in real time."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder that holds the model."""
    out: Annotated[Path, arg(metavar="FILE.gif|FILE.mp4")]
    """The film; an MP4 needs the extra `video`."""
    episodes: Annotated[int, arg(metavar="N")] = 3
    """How many demonstrations, from the first on, one after another."""
    fps: Annotated[int, arg(metavar="N")] = 30
    """Pictures a second."""
    width: Annotated[int, arg(metavar="PIXELS")] = 480
    """Width of the picture."""
    height: Annotated[int, arg(metavar="PIXELS")] = 360
    """Height of the picture."""
    camera: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: the model's first)")] = ""
    """A camera of the model; one that shows all of it where the model has none."""
    untrusted: bool = False
    """Its model comes from strangers: try it first in a process of its own, in bounded memory and time."""

    def __call__(self) -> None:
        """Films it."""
        from planspace.demos.folder import load_demos
        from planspace.demos.render import FilmConfig, render_demos
        from planspace.mjcf.subprocess_model import compile_apart

        config = FilmConfig(self.episodes, self.fps, self.width, self.height, self.camera)
        demos = load_demos(self.folder)
        if self.untrusted:
            compile_apart(demos.info.mjcf)
        render_demos(demos, self.out, config)
        print(self.out)


@dataclass(frozen=True)
class DemosImport:
    """Make a dataset of demonstrations in another format: NPZ, CSV, Minari, or the plans of 2020."""

    source: Positional[Annotated[tuple[str, ...], arg(metavar="SOURCE", help_behavior_hint="(required)")]]
    """FILE.npz with `states`, `controls`, `time`, `offsets`; FILE.csv, one demonstration a file or a column
    `episode`; minari:ID; 2020's .json or .out plans. Several files, or a folder of them, make one dataset."""
    out: Annotated[Path, arg(metavar="DIR")]
    """The dataset folder to make."""
    problem: Annotated[str, arg(metavar="PROBLEM|FILE.yaml", help_behavior_hint="(default: none)")] = ""
    """The planning problem the states belong to: gives names, units, angles and the model."""
    state: UseAppendAction[
        Annotated[tuple[str, ...], arg(metavar="NAME=COLUMN", help_behavior_hint="(repeatable)")]
    ] = ()
    """Which column is a state; NAME=INDEX or NAME=KEY[INDEX] in Minari. By default columns go by name."""
    control: UseAppendAction[
        Annotated[tuple[str, ...], arg(metavar="NAME=COLUMN", help_behavior_hint="(repeatable)")]
    ] = ()
    """Which column is a control. By default control1 .., control0 .., or the actuators' names."""
    dt: Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint="(default: none)")] = None
    """The time step, for a source that does not say."""
    as_recorded: bool = False
    """Keep uneven time steps and wound-up angles. Otherwise all demonstrations are brought to one step, and
    angles to end in (-pi, pi]."""
    untrusted: bool = False
    """The problem comes from strangers: its model is read in a process of its own, in bounded memory and
    time."""

    def __call__(self) -> None:
        """Imports it."""
        from planspace.demos.convert import import_demos
        from planspace.demos.recording import ImportOptions, assignments
        from planspace.plan.generate import state_info
        from planspace.tasks.problem_file import load_problem

        states, controls = assignments("--state", self.state), assignments("--control", self.control)
        options = ImportOptions(states, controls, self.dt, self.as_recorded)
        problem = load_problem(self.problem, untrusted=self.untrusted) if self.problem else None
        folder = import_demos(self.source, self.out, state_info(problem) if problem else None, options)
        print(f"{folder.num_episodes} demonstrations in {self.out}")


@dataclass(frozen=True)
class DemosExport:
    """Write a dataset in a format that `demos import` reads back."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder."""
    target: Positional[Annotated[str, arg(metavar="FILE.npz|FILE.csv|minari:ID")]]
    """What to write; a Minari dataset is kept where Minari keeps its own."""

    def __call__(self) -> None:
        """Exports it."""
        from planspace.demos.convert import export_demos
        from planspace.demos.folder import load_demos

        print(export_demos(load_demos(self.folder), self.target))


@dataclass(frozen=True)
class Demos:
    """Look at, check, draw, film, import and export demonstrations."""

    action: (
        Annotated[DemosShow, subcommand("show")]
        | Annotated[DemosValidate, subcommand("validate")]
        | Annotated[DemosPlot, subcommand("plot")]
        | Annotated[DemosRender, subcommand("render")]
        | Annotated[DemosImport, subcommand("import")]
        | Annotated[DemosExport, subcommand("export")]
    )

    def __call__(self) -> None:
        """Hands on to the action."""
        self.action()
