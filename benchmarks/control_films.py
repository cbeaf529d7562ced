"""Film what the controllers of `control.py` did, each episode beside a plan, for docs/control.md.

    python benchmarks/control.py runs/control
    python benchmarks/control_films.py runs/control

Films the first episodes of each problem that stayed at the goal, up to where they arrived.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from planspace.control.plant import Plant
from planspace.control.runs import DEMOS
from planspace.demos.load import load_demos
from planspace.demos.render import FIT, FilmConfig
from planspace.study.control_report import film_beside_plans

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
SHOWN = {
    "pendulum-swingup": ("time", 0.32),
    "acrobot-swingup": ("time", 0.64),
    "quadrotor-planar": ("z", 0.32),
    "quadrotor": ("z", 0.16),
    "ball-pendulum": ("time", 0.32),
    "arm": ("z", 0.16),
    "reacher": ("z", 0.16),
}
"""The cost and the horizon [s] of each film."""
FITTED = ("quadrotor-planar", "quadrotor", "arm")
"""Problems whose robot is small in the picture of the model's own camera."""
SMALL = FilmConfig(episodes=1, fps=14, width=200, height=170, pause_s=1.0)


def main() -> None:
    """Film one episode of each problem."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="the folder of control.py")
    parser.add_argument("--only", default="", help="only problems whose name contains this")
    options = parser.parse_args()
    for name, (cost, horizon) in SHOWN.items():
        if options.only in name:
            episodes = load_demos(options.folder / f"{name}-{cost}-{horizon}" / DEMOS)
            plans = load_demos(options.folder / f"{Plant.find(name).problem.name}-trees")
            config = replace(SMALL, camera=FIT if name in FITTED else "")
            film_beside_plans(episodes, plans, FIGURES / f"control-{name}.gif", config)


if __name__ == "__main__":
    main()
