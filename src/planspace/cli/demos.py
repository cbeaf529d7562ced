"""`planspace demos`: the verbs for datasets of demonstrations."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg, subcommand

from planspace.cli.demos_import import Import
from planspace.cli.tables import print_values

DEMOS_HELP = "A dataset folder, or the name of ready-made plans."
DemosFolder = Positional[Annotated[Path, arg(metavar="DEMOS", help=DEMOS_HELP)]]
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
    """A camera of the model, or fit: a camera that is fitted to the whole motion. A model without cameras
    uses fit."""
    pause_s: Annotated[float, arg(metavar="S")] = 0.0
    """How long the last pose of each demonstration stays [s]."""
    untrusted: Untrusted = False

    def __call__(self) -> None:
        """Render and save the film."""
        from planspace.demos.load import load_demos
        from planspace.demos.render import FilmConfig, render_demos
        from planspace.mjcf.subprocess_model import check_compiles

        config = FilmConfig(self.episodes, self.fps, self.width, self.height, self.camera, self.pause_s)
        demos = load_demos(self.folder)
        if self.untrusted:
            check_compiles(demos.info.source or "")
        render_demos(demos, self.out, config)
        print(self.out)


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
class Merge:
    """Join datasets of the same robot, such as plans with different seeds from several machines."""

    folders: Positional[Annotated[tuple[Path, ...], arg(metavar="DEMOS DEMOS ...", help=DEMOS_HELP)]]
    out: Annotated[Path, arg(metavar="DIR")]
    """The folder of the joined dataset."""

    def __call__(self) -> None:
        """Join and save the datasets."""
        from planspace.demos.load import load_demos
        from planspace.demos.merge import merge_demos

        parts = [load_demos(folder) for folder in self.folders]
        merged = merge_demos(parts, [str(folder) for folder in self.folders])
        merged.save(self.out)
        if any(part.trees for part in parts) and not merged.trees:
            print("Search trees are left out, because not all datasets have them.", file=sys.stderr)
        if any(part.splits for part in parts):
            print("The splits that the sources named are left out; `embed` draws its own.", file=sys.stderr)
        print(merged)


@dataclass(frozen=True)
class Demos:
    """Show, check, draw, film, join, import and export demonstrations."""

    action: (
        Annotated[Show, subcommand("show")]
        | Annotated[Validate, subcommand("validate")]
        | Annotated[Plot, subcommand("plot")]
        | Annotated[Render, subcommand("render")]
        | Annotated[Merge, subcommand("merge")]
        | Annotated[Import, subcommand("import")]
        | Annotated[Export, subcommand("export")]
    )

    def __call__(self) -> None:
        """Run the action."""
        self.action()
