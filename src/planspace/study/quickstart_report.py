"""The report of `planspace run`: one self-contained HTML file, and its figures as files."""

import base64
from pathlib import Path

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.render import FilmConfig, render_side_by_side
from planspace.embed.embedding import Embedding
from planspace.errors import PlanspaceError
from planspace.figures.controlled_paths import PLANS, PlotSpace, draw_distances, draw_paths
from planspace.figures.demos import plot_demos
from planspace.figures.interactive_paths import MAX_INTERACTIVE, interactive_paths, interactive_points
from planspace.figures.learning_curves import plot_curves
from planspace.figures.paths import embedded_paths
from planspace.figures.style import save_figure
from planspace.rl.learning_curve import SMOOTHING, learning_curve
from planspace.rl.play import play
from planspace.rl.saved_policy import load_policy
from planspace.storage.files import make_folder
from planspace.study.control_report import as_data, first_episodes, nearest_plans
from planspace.study.figures import interactive_curves, plain_layout, plot_paths
from planspace.study.html import embedded, write_page
from planspace.study.run_control import COST_NAMES, controlled_episodes
from planspace.study.run_policies import TRAIN, Policies, shipped_bands
from planspace.study.run_summary import FINAL_ITERATIONS, GEOMETRY_ROWS, RunSummary
from planspace.study.run_text import headline
from planspace.tasks.stored_task import FOLDER
from planspace.tasks.task import Task

DRAWN = 30
"""Most plans, and most episodes of a controller, that are drawn."""
FILMED = FilmConfig(episodes=1, fps=15, width=240, height=240)
BY_Z, BY_RAW, POLICY = "control by z", "control by raw distance", "policy with z"


def write_report(
    out: Path, summary: RunSummary, task: Task, demos: Demos, embedding: Embedding, policies: Policies | None
) -> Path:
    """Write `report.html` and `figures/` into a run's folder.

    Args:
        out: the run's folder, with its control stage.
        summary: what the page says.
        task: the task.
        demos: the demonstrations.
        embedding: the embedding.
        policies: the policies; None without `--train`.

    Returns:
        The path of the report.

    Raises:
        PlanspaceError: a file cannot be read or written.
    """
    folder = make_folder(out / "figures")
    demo_picture = save_figure(plot_demos(demos), folder, "demos")
    save_figure(plot_paths(demos, embedding), folder, "paths")
    return write_page(
        out / "report.html",
        "quickstart.html",
        summary=summary,
        given=given_as(task, out),
        headline=headline(summary.control),
        cost_names=COST_NAMES,
        geometry_rows=GEOMETRY_ROWS,
        final_iterations=FINAL_ITERATIONS,
        smoothing=SMOOTHING,
        demo_picture="data:image/png;base64," + base64.b64encode(demo_picture.read_bytes()).decode(),
        paths=_paths(demos, embedding),
        **_control(out, summary, task, demos, embedding, policies),
        **_curves(folder, task, policies),
    )


def given_as(task: Task, out: Path) -> str:
    """What the command line was given: the name of the problem file that the run keeps, or of the task."""
    kept = sorted((out / FOLDER).glob("*.yaml"))
    return kept[0].name if kept else task.name


def _control(
    out: Path, summary: RunSummary, task: Task, demos: Demos, embedding: Embedding, policies: Policies | None
) -> dict[str, object]:
    """Film and figures of the control stage."""
    found = summary.control.reached
    if found is None:
        return {"film": "", "film_note": "", "controlled": [], "distances": []}
    controlled = {
        BY_Z: controlled_episodes(out, "z", found.horizon_s),
        BY_RAW: controlled_episodes(out, "raw", found.horizon_s),
    }
    groups = {name: first_episodes(episodes, DRAWN) for name, episodes in controlled.items()}
    groups[PLANS] = first_episodes(demos, DRAWN)
    spaces = PlotSpace.z(embedding, demos), PlotSpace.raw(embedding, demos)
    film, note = _film(out, task, demos, controlled, policies)
    narrow = {
        **plain_layout(),
        "height": 400,
        "margin": {"l": 45, "r": 10, "t": 60, "b": 45},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom"},
    }
    return {
        "film": film,
        "film_note": note,
        "controlled": [
            (space.name, embedded(draw_paths(space, groups).update_layout(**narrow))) for space in spaces
        ],
        "distances": [embedded(draw_distances(space, groups).update_layout(**narrow)) for space in spaces],
    }


def _film(
    out: Path, task: Task, demos: Demos, controlled: dict[str, Demos], policies: Policies | None
) -> tuple[str, str]:
    """The film as data, and why it is missing; one of the two is empty. A film that exists is kept."""
    first = {name: first_episodes(episodes, FILMED.episodes) for name, episodes in controlled.items()}
    shown = {PLANS: nearest_plans(demos, first[BY_Z]), **first}
    if policies is not None and not task.target_size:
        policy = load_policy(out / TRAIN / policies.folder)
        starts = np.stack([first[BY_Z].episode(i).states[0] for i in range(len(first[BY_Z]))])
        shown[POLICY] = play(policy, len(starts), 0, task, starts)[1]
    file = out / "figures" / f"film-{len(shown)}.gif"
    try:
        if not file.exists():
            render_side_by_side(shown, file, FILMED)
    except PlanspaceError as error:
        return "", f"The film is left out: {error}"
    return as_data(file), ""


def _paths(demos: Demos, embedding: Embedding) -> str:
    """Every demonstration in z."""
    drawn = embedded_paths(
        embedding, demos, np.arange(len(demos)), MAX_INTERACTIVE, interactive_points(embedding.state_dim)
    )
    return embedded(interactive_paths(drawn).update_layout(**plain_layout()))


def _curves(folder: Path, task: Task, policies: Policies | None) -> dict[str, object]:
    """The learning curves, if there are policies."""
    if policies is None:
        return {"curves": "", "has_bands": False}
    curves = {label: learning_curve(history) for label, history in policies.histories.items()}
    save_figure(plot_curves(curves, task.name), folder, "curves")
    bands = shipped_bands(task.name, max(int(curve.steps[-1]) for curve in curves.values()))
    figure = interactive_curves(curves, bands, task.solved_return)
    return {"curves": embedded(figure), "has_bands": bool(bands)}
