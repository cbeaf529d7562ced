"""The report of a study: one self-contained HTML file, and its figures and tables as files."""

import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from planspace.embed.training_log import LogRow
from planspace.errors import PlanspaceError
from planspace.figures.learning_curves import MAX_BANDS, plot_curves
from planspace.figures.style import save_figure
from planspace.figures.training_curves import plot_training
from planspace.rl.learning_curve import SMOOTHING, Curve, learning_curve
from planspace.storage.files import make_folder, write_bytes
from planspace.storage.json_files import write_json
from planspace.study import stats
from planspace.study.design import Arm
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
from planspace.study.summary import ABOUT, folder_of_study, summarise
from planspace.study.tables import ArmRow, StudySummary
from planspace.study.tidy import FILE, write_tidy
from planspace.study.unit import FitUnit

SPACES = "demonstrations-in-z"
"""The figure of embeddings."""
MAX_SPACES = 8
"""Number of embeddings with an interactive figure. Browsers limit the number of WebGL frames."""
THRESHOLDS = 200


def write_report(findings: Findings, out: Path) -> tuple[StudySummary, Path]:
    """Write `DIR/STUDY-BUDGET/`: report.html, tables.md, tables.json, results.csv and figures.

    Args:
        findings: what is known of the study.
        out: the folder of the studies.

    Returns:
        The tables, and the report's path.

    Raises:
        PlanspaceError: nothing is done yet.
    """
    study = findings.study
    if not findings.scores:
        raise PlanspaceError(f"no arm of study {study.name} has been run in {out} yet.")
    summary = summarise(findings)
    folder = make_folder(folder_of_study(study, out))
    figures = make_folder(folder / "figures")
    tables = json.dumps(asdict(summary), indent=1, allow_nan=False) + "\n"
    write_bytes(folder / "tables.json", tables.encode())
    if any(scores.reached is None for scores in findings.scores.values()):  # else this is what was read
        write_tidy(findings, folder / FILE)
        write_json(folder / ABOUT, _about(findings))
    panels = []
    for panel, arms in findings.panels().items():
        curves = {arm.label: _curve(findings, arm) for arm in arms}
        reached = {arm.label: stats.final(findings.scores[arm.name]) for arm in arms}
        profiles = _profiles(reached)
        rows = summary.panels[panel]
        title = f"{panel}: {_seeds(rows)} seeds of {summary.steps / 1e6:g} M steps"
        save_figure(plot_curves(curves, title), figures, slug(panel))
        save_figure(plot_reached(reached, rows, title), figures, f"{slug(panel)}-reached")
        save_figure(plot_profiles(profiles, title), figures, f"{slug(panel)}-profile")
        panels.append(
            {
                "name": panel,
                "slug": slug(panel),
                "rows": rows,
                "curves": embedded(interactive_curves(curves)),
                "profiles": embedded(interactive_profiles(profiles)),
                "films": [film for arm in arms if (film := _film(findings, arm))],
            }
        )
    spaces = _spaces(findings)
    if spaces:
        save_figure(plot_spaces(spaces), figures, SPACES)
    content = dict(
        summary=summary,
        study=study,
        versions=findings.versions,
        panels=panels,
        spaces_figure=SPACES,
        final_steps=stats.FINAL_STEPS,
        visible=stats.VISIBLE_RATIO,
        trainings=_trainings(findings, figures),
        spaces=[{"name": name, "paths": embedded(interactive_lines(x))} for name, x in spaces.items()],
    )
    write_page(folder / "tables.md", "tables.md", **content)
    path = write_page(
        folder / "report.html",
        "study.html",
        smoothing=SMOOTHING,
        max_bands=MAX_BANDS,
        **content,
    )
    return summary, path


def slug(name: str) -> str:
    """A name as part of a file's name."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _curve(findings: Findings, arm: Arm) -> Curve:
    scores = findings.scores[arm.name]
    iterations_a_row = max(1, round(arm.units[0].config.iterations / len(scores.steps)))
    history = {"steps": scores.steps, "return": scores.returns}
    return learning_curve(history, max(1, SMOOTHING // iterations_a_row))


def _about(findings: Findings) -> dict[str, Any]:
    study = findings.study
    names = {"study": study.name, "budget": study.budget, "only": list(study.parts)}
    return {**names, "command": study.command, "versions": dict(findings.versions)}


def _seeds(rows: list[ArmRow]) -> str:
    """The number of seeds of an arm: 15, or 15 to 75."""
    counts = [row.seeds for row in rows]
    return f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"


def _profiles(reached: dict[str, np.ndarray]) -> dict[str, Profile]:
    everything = np.concatenate(list(reached.values()))
    margin = 0.05 * max(float(np.ptp(everything)), 1e-9)
    thresholds = np.linspace(everything.min() - margin, everything.max() + margin, THRESHOLDS)
    return {label: (thresholds, stats.profile(x, thresholds)) for label, x in reached.items()}


def _film(findings: Findings, arm: Arm) -> dict[str, Any] | None:
    """The episode of the best seed, of the block whose evaluation ended best; None if no film is kept."""
    found = [findings.policies(unit) for unit in arm.units if findings.done(unit)]
    found = [result for result in found if result.film is not None]
    if not found:
        return None
    best = max(found, key=lambda result: max(_number(x) for x in result.eval_returns[-1]))
    assert best.film is not None
    return {"label": arm.label, **asdict(best.film)}


def _number(x: float | None) -> float:
    return -np.inf if x is None else x  # it was not finite


def _trainings(findings: Findings, figures: Path) -> list[dict[str, str]]:
    """The curves of embeddings that were chosen among several seeds, as the paper shows them."""
    shown = []
    for name, unit in named_fits(findings).items():
        found = findings.fit(unit)
        if unit.num_seeds < 2 or not found.bound:
            continue
        columns = zip(found.log_steps, found.path_error, found.bound, strict=True)
        rows = [LogRow(step=step, path_error=error, bound=bound) for step, error, bound in columns]
        title, file = f"{name}, z of {unit.config.z_dim} numbers", f"training-{slug(name)}"
        save_figure(plot_training(rows, found.seed - unit.seed, title=title), figures, file)
        shown.append(
            {
                "name": title,
                "file": file,
                "kept": f"seed {found.seed - unit.seed}",
                "path_error": embedded(interactive_training(found.log_steps, found.path_error, "path error")),
                "bound": embedded(interactive_training(found.log_steps, found.bound, "bound [nats]")),
            }
        )
    return shown


def _spaces(findings: Findings) -> dict[str, Any]:
    """Demonstrations as embeddings see them: the first seed of each kind, on the largest dataset."""
    kinds: dict[tuple[Any, ...], tuple[str, FitUnit]] = {}
    for name, unit in named_fits(findings).items():
        kind = (replace(unit.plans, num=0), unit.config)
        _, known = kinds.get(kind, (name, unit))
        if kind not in kinds or unit.plans.num > known.plans.num:
            kinds[kind] = name, unit
    shown = {name: findings.fit(unit).paths for name, unit in list(kinds.values())[:MAX_SPACES]}
    return {name: paths for name, paths in shown.items() if paths}
