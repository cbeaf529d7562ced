"""The report of `planspace control`: a film, paths in z and numbers in one self-contained HTML file."""

import base64
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from planspace.control.config import ControlConfig
from planspace.control.runs import EPISODES, ControlSummary
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.render import FilmConfig, render_demos, render_side_by_side
from planspace.embed.embedding import Embedding
from planspace.figures.controlled_paths import PLANS, PlotSpace, draw_distances, draw_paths
from planspace.study.figures import plain_layout
from planspace.study.html import embedded, write_page

FILM, REPORT = "film.gif", "report.html"
FILMED = FilmConfig(episodes=2, fps=20)
DRAWN = 60
"""Most plans and most episodes that are drawn."""
HINTS = {
    "success": "fraction of episodes at the goal for the whole last second",
    "return_mean": "mean return of the task's reward",
    "return_worst": "smallest return",
    "real_time": "fraction of controls computed within a control step, on one core",
    "regulated": "fraction of control steps in which the regulator at the goal acted",
    "followed": "fraction of control steps that followed a plan",
}


def write_control_report(
    out: Path,
    summary: ControlSummary,
    config: ControlConfig,
    embedding: Embedding | None,
    plans: Demos | None = None,
    *,
    film: bool = True,
) -> Path:
    """Write `film.gif` and `report.html` into the folder of a run.

    Args:
        out: the folder.
        summary: what the episodes amount to.
        config: how the controller looked ahead.
        embedding: draws paths in z; None leaves them out.
        plans: plans with the same states, to show beside the episodes.
        film: whether to film the first episodes. A film that exists is kept.

    Returns:
        The path of the report.

    Raises:
        PlanspaceError: a file cannot be read or written, or the robot cannot be drawn.
    """
    episodes = load_demos(out / EPISODES)
    if film and not (out / FILM).exists():
        film_beside_plans(episodes, plans, out / FILM)
    figures = {"paths": "", "distance": ""}
    if embedding is not None:
        groups = {"controlled episode": first_episodes(episodes, DRAWN)}
        if plans is not None:
            groups[PLANS] = first_episodes(plans, DRAWN)
        space, layout = PlotSpace.z(embedding, episodes), plain_layout()
        figures["paths"] = embedded(draw_paths(space, groups).update_layout(**layout))
        figures["distance"] = embedded(draw_distances(space, groups).update_layout(**layout))
    return write_page(
        out / REPORT,
        "control.html",
        problem=episodes.info.problem,
        summary=summary,
        cost=config.cost,
        plans=plans is not None,
        film=as_data(out / FILM) if film else "",
        rows=[(name, f"{getattr(summary, name):.3g}", hint) for name, hint in HINTS.items()],
        **figures,
    )


def film_beside_plans(episodes: Demos, plans: Demos | None, file: Path, config: FilmConfig = FILMED) -> None:
    """Film the first episodes, each beside the plan whose start is nearest.

    Args:
        episodes: what a controller did.
        plans: plans of the same problem; None films the episodes without plans.
        file: the GIF or MP4 file to write.
        config: the settings; width and height are those of one picture.

    Raises:
        PlanspaceError: the file cannot be written, or the robot cannot be drawn.
    """
    if plans is None:
        render_demos(episodes, file, config)
        return
    shown = first_episodes(episodes, config.episodes)
    render_side_by_side({PLANS: nearest_plans(plans, shown), "controller": shown}, file, config)


def nearest_plans(plans: Demos, episodes: Demos) -> Demos:
    """For each episode, the plan whose start is nearest; states are divided by their standard deviation."""
    starts = np.stack([plans.episode(i).states[0] for i in range(len(plans))])
    scale = starts.std(axis=0) + 1e-9
    firsts = [episodes.episode(i).states[0] for i in range(len(episodes))]
    return _chosen(plans, [int(np.argmin(np.abs((starts - x) / scale).sum(axis=1))) for x in firsts])


def first_episodes(demos: Demos, num: int) -> Demos:
    """The first episodes of a dataset, at most `num`."""
    return _chosen(demos, range(min(len(demos), num)))


def _chosen(demos: Demos, numbers: Iterable[int]) -> Demos:
    return Demos.from_episodes(demos.info, [demos.episode(i) for i in numbers])


def as_data(film: Path) -> str:
    """A GIF as the source of an image in a page."""
    return "data:image/gif;base64," + base64.b64encode(film.read_bytes()).decode()
