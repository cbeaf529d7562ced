"""`planspace curves`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.errors import UsageError


@dataclass(frozen=True)
class Curves:
    """Draw the learning curves of several runs of one task in one figure.

    A line is the mean return over seeds, smoothed over 10 iterations. A band spans the second worst to the
    second best seed. The dashed line is the run with the highest smoothed return.
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for curves.png and curves.svg."""
    runs: Positional[
        Annotated[tuple[Path, ...], arg(metavar="RUN ...", help_behavior_hint="(required)")]
    ] = ()
    """Folders made by `planspace train`."""
    title: str = ""
    """Title of the figure."""

    def __call__(self) -> None:
        """Draw and save the figure."""
        from planspace.figures.learning_curves import plot_curves
        from planspace.figures.style import save_figure
        from planspace.rl.history import load_history
        from planspace.rl.learning_curve import learning_curve
        from planspace.storage.files import make_folder

        if not self.runs:
            raise UsageError("which runs? Give the folders that `planspace train` made.")
        curves = {str(run): learning_curve(load_history(run)) for run in self.runs}
        _check_same_returns(self.runs)
        print(save_figure(plot_curves(curves, self.title), make_folder(self.out), "curves"))


def _check_same_returns(runs: Sequence[Path]) -> None:
    """Check that the returns of runs may stand in one figure.

    Raises:
        UsageError: the runs are of different tasks or rewards.
    """
    from planspace.rl.saved_policy import DEFAULTS, DESCRIPTION, SCHEMA
    from planspace.storage.json_files import read_description

    def measured(run: Path) -> str:
        about = DEFAULTS | read_description(run / DESCRIPTION, kind="policies", schema=SCHEMA)
        return f"{about.get('task')} with the {about['reward']} reward"

    first = measured(runs[0])
    for run in runs[1:]:
        if (other := measured(run)) != first:
            raise UsageError(
                f"these returns cannot be compared: {runs[0]} is {first}, {run} is {other}. "
                "Draw each in a figure of its own."
            )
