"""The report of a study: one self-contained HTML file, and its figures and tables in separate files."""

import base64
import json
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from planspace.embed.config import FitConfig
from planspace.embed.training_log import LogRow
from planspace.errors import PlanspaceError
from planspace.figures.learning_curves import MAX_BANDS, MEAN_RETURN, plot_curves
from planspace.figures.style import save_figure
from planspace.figures.training_curves import plot_training
from planspace.rl.learning_curve import SMOOTHING, Curve, learning_curve
from planspace.storage.files import make_folder, write_bytes
from planspace.storage.json_files import write_json
from planspace.study import stats
from planspace.study.answer import answer
from planspace.study.design import Arm, solved_level
from planspace.study.figures import (
    Profile,
    interactive_curves,
    interactive_lines,
    interactive_profiles,
    interactive_training,
    plot_profiles,
    plot_reached,
    plot_spaces,
)
from planspace.study.findings import Findings, named_fits
from planspace.study.html import embedded, write_page
from planspace.study.results import Film, Paths, PoliciesResult, SeedRow
from planspace.study.summary import ABOUT, folder_of_study, summarise
from planspace.study.tables import ArmRow, StudySummary
from planspace.study.tidy import FILE, write_tidy
from planspace.study.unit import FitUnit

SPACES = "demonstrations-in-z"
"""File name of the figure of demonstrations in z."""
MAX_SPACES = 8
"""Number of embeddings with an interactive figure. Browsers limit the number of WebGL frames."""
THRESHOLDS = 200
"""Number of points of a performance profile."""


@dataclass(frozen=True)
class _Panel:
    """A figure of the study, with its table."""

    name: str
    slug: str
    rows: list[ArmRow]
    has_level: bool
    """Whether there is a return above which a seed counts as having solved the task."""
    curves: str
    """Learning curves, as HTML."""
    profiles: str
    """Performance profiles, as HTML."""
    films: list[tuple[str, Film]]
    """The arm's label and its film, for each arm that has one."""


@dataclass(frozen=True)
class _Training:
    """The training of an embedding that was selected among several seeds."""

    name: str
    file: str
    """Name of the figure's file, without suffix."""
    selected: int
    """Position of the selected seed."""
    path_error: str
    """Curves as HTML."""
    bound: str
    """Curves as HTML."""


def write_report(findings: Findings, out: Path) -> tuple[StudySummary, Path]:
    """Write `DIR/STUDY-BUDGET/`: report.html, tables.md, tables.json, results.csv and figures.

    Args:
        findings: the results of the study so far.
        out: the folder of the studies.

    Returns:
        The tables, and the path of the report.

    Raises:
        PlanspaceError: no arm has results yet.
    """
    study = findings.study
    if not findings.scores:
        raise PlanspaceError(f"no arm of study {study.name} has been run in {out} yet.")
    summary = summarise(findings)
    folder = make_folder(folder_of_study(study, out))
    figures = make_folder(folder / "figures")
    _write_tables(findings, summary, folder)
    spaces = _spaces(findings)
    if spaces:
        save_figure(plot_spaces(spaces), figures, SPACES)
    content = dict(
        summary=summary,
        study=study,
        versions=findings.versions,
        panels=[_panel(findings, name, arms, summary, figures) for name, arms in findings.panels().items()],
        spaces_figure=SPACES,
        final_steps=stats.FINAL_STEPS,
        visible=stats.VISIBLE_RATIO,
        trainings=_trainings(findings, figures),
        spaces={name: embedded(interactive_lines(paths)) for name, paths in spaces.items()},
    )
    write_page(folder / "tables.md", "tables.md", **content)
    page = folder / "report.html"
    opening = {"answer": answer(summary), "pictures": _pictures(figures, summary)}
    write_page(page, "study.html", smoothing=SMOOTHING, max_bands=MAX_BANDS, **content, **opening)
    return summary, page


def _pictures(figures: Path, summary: StudySummary) -> list[tuple[str, str]]:
    """The pictures at the top of the report: the caption of each, and its source as data."""
    panel = next(iter(summary.panels))
    files = {
        SPACES: "Demonstrations in z, for each embedding",
        slug(panel): f"{panel}: returns while learning",
        f"{slug(panel)}-reached": f"{panel}: final return of each seed",
    }
    found = {name: figures / f"{name}.png" for name in files}
    return [(files[name], _as_data(file)) for name, file in found.items() if file.exists()]


def _as_data(file: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode()


def _write_tables(findings: Findings, summary: StudySummary, folder: Path) -> None:
    """Write tables.json, results.csv and study.json."""
    tables = json.dumps(asdict(summary), indent=1, allow_nan=False) + "\n"
    write_bytes(folder / "tables.json", tables.encode())
    if all(scores.reached is not None for scores in findings.scores.values()):
        return  # the findings were read from results.csv, which has fewer points than the units
    write_tidy(findings, folder / FILE)
    study = findings.study
    about = {
        "study": study.name,
        "budget": study.budget,
        "only": list(study.parts),
        "command": study.command,
        "versions": dict(findings.versions),
    }
    write_json(folder / ABOUT, about)


def _panel(findings: Findings, name: str, arms: list[Arm], summary: StudySummary, figures: Path) -> _Panel:
    """Draw the figures of a panel, and return its part of the report."""
    curves = {arm.label: _curve(findings, arm) for arm in arms}
    reached = {arm.label: stats.final(findings.scores[arm.name]) for arm in arms}
    profiles, rows = _profiles(reached), summary.panels[name]
    steps = arms[0].units[0].config.steps
    title = f"{name}: {_seeds(rows)} seeds of {steps / 1e6:g} M steps"
    shown = "return of evaluations" if findings.study.evaluated else MEAN_RETURN
    save_figure(plot_curves(curves, title, shown), figures, slug(name))
    save_figure(plot_reached(reached, rows, title), figures, f"{slug(name)}-reached")
    save_figure(plot_profiles(profiles, title), figures, f"{slug(name)}-profile")
    return _Panel(
        name=name,
        slug=slug(name),
        rows=rows,
        has_level=any(solved_level(arm) is not None for arm in arms),
        curves=embedded(interactive_curves(curves)),
        profiles=embedded(interactive_profiles(profiles)),
        films=[(arm.label, film) for arm in arms if (film := _film(findings, arm))],
    )


def slug(name: str) -> str:
    """Turn a name into a part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _curve(findings: Findings, arm: Arm) -> Curve:
    scores = findings.scores[arm.name]
    iterations_per_row = max(1, round(arm.units[0].config.iterations / len(scores.steps)))
    history = {"steps": scores.steps, "return": scores.returns}
    return learning_curve(history, max(1, SMOOTHING // iterations_per_row))


def _seeds(rows: list[ArmRow]) -> str:
    """The number of seeds of an arm: 15, or 15 to 75."""
    counts = [row.seeds for row in rows]
    return f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"


def _profiles(reached: dict[str, np.ndarray]) -> dict[str, Profile]:
    returns = np.concatenate(list(reached.values()))
    margin = 0.05 * max(float(np.ptp(returns)), 1e-9)
    thresholds = np.linspace(returns.min() - margin, returns.max() + margin, THRESHOLDS)
    return {label: (thresholds, stats.profile(x, thresholds)) for label, x in reached.items()}


def _film(findings: Findings, arm: Arm) -> Film | None:
    """The film of the block with the best seed in the last evaluation; None if no block has a film."""
    blocks = [findings.policies(unit) for unit in arm.units if findings.done(unit)]
    with_film = [block for block in blocks if block.film is not None]
    if not with_film:
        return None
    return max(with_film, key=_best_evaluation).film


def _best_evaluation(block: PoliciesResult) -> float:
    return max(-np.inf if x is None else x for x in block.eval_returns[-1])


def _trainings(findings: Findings, figures: Path) -> list[_Training]:
    """Draw the training curves of the embeddings that were selected among several seeds."""
    shown = []
    for name, unit in named_fits(findings).items():
        found = findings.fit(unit)
        if unit.num_seeds < 2 or not found.bound:
            continue
        columns = zip(found.log_steps, found.path_error, found.bound, strict=True)
        rows = [
            LogRow(step=step, path_error=_numbers(error), bound=_numbers(bound))
            for step, error, bound in columns
        ]
        title, file = f"{name}, z of {unit.config.z_dim} numbers", f"training-{slug(name)}"
        selected = found.seed - unit.seed
        save_figure(plot_training(rows, selected, title=title), figures, file)
        path_error = interactive_training(found.log_steps, found.path_error, "path error")
        bound = interactive_training(found.log_steps, found.bound, "bound [nats]")
        shown.append(_Training(title, file, selected, embedded(path_error), embedded(bound)))
    return shown


def _numbers(row: SeedRow) -> list[float]:
    return [np.nan if x is None else x for x in row]


def _spaces(findings: Findings) -> dict[str, Paths]:
    """Demonstrations in z by the embedding's name.

    Embeddings that differ only in the seed or the number of demonstrations count as one kind. The first seed
    with the most demonstrations stands for its kind.
    """
    kinds: dict[tuple[str, FitConfig], tuple[str, FitUnit]] = {}
    for name, unit in named_fits(findings).items():
        kind = (replace(unit.plans, num=0).name, unit.config)
        _, known = kinds.get(kind, (name, unit))
        if kind not in kinds or unit.plans.num > known.plans.num:
            kinds[kind] = name, unit
    shown = {name: findings.fit(unit).paths for name, unit in list(kinds.values())[:MAX_SPACES]}
    return {name: paths for name, paths in shown.items() if paths}
