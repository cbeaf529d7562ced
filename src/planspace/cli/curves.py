"""`planspace curves`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.errors import UsageError


@dataclass(frozen=True)
class Curves:
    """Draw the learning curves of runs into one figure, as the paper does."""

    out: Annotated[Path, arg(metavar="DIR")]
    """Where curves.png and curves.svg go."""
    runs: Positional[Annotated[tuple[Path, ...], arg(metavar="RUN ...")]] = ()
    """Folders of `planspace train`. Line: mean over seeds of returns smoothed over 10 iterations. Band:
    second worst to second best seed. Dashed: the run with the highest smoothed return at any point."""
    title: str = ""
    """Above the figure."""

    def __call__(self) -> None:
        """Draws them."""
        from planspace.figures.learning_curves import learning_curve, plot_curves
        from planspace.figures.style import save_figure
        from planspace.rl.history import load_history
        from planspace.storage.files import make_folder

        if not self.runs:
            raise UsageError("which runs? Give folders that `planspace train` made.")
        curves = {str(run): learning_curve(load_history(run)) for run in self.runs}
        print(save_figure(plot_curves(curves, self.title), make_folder(self.out), "curves"))
