"""Every number of the README and the docs that comes from results/ is computed again from its CSV files.

Timings cannot be computed again; next to them the docs name the command that measures them.
"""

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from planspace.study.grid import make_study
from planspace.study.summary import read_findings, summarise
from planspace.study.tables import ArmRow, ClaimRow, Estimate, StudySummary
from planspace.study.tidy import Row, read_rows

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
STUDIES = sorted(path.parent.name for path in (RESULTS / "study").glob("*/study.json"))
MOST_BYTES = 5_000_000
NUMBER = r"-?\d[\d,]*(?:\.\d+)?"
ESTIMATE = re.compile(rf"({NUMBER}) \((-?\d[\d.]*), (-?\d[\d.]*)\)")
WITH_SEEDS = re.compile(r"(-?\d+\.\d+) \((-?\d+\.\d+) ± (\d+\.\d+)\)")
BOOTSTRAP_NOISE = 7.0
"""Ends of an interval that was resampled with other random numbers differ by as much [return]."""


@cache
def summary(name: str) -> StudySummary:
    about = json.loads((RESULTS / "study" / name / "study.json").read_text())
    study = make_study(about["study"], about["budget"]).only(about["only"])
    return summarise(read_findings(study, RESULTS / "study"))


def written(estimate: Estimate, decimals: int) -> str:
    number, (low, high) = estimate
    return f"{number:.{decimals}f} ({low:.{decimals}f}, {high:.{decimals}f})".replace("-0 ", "0 ")


def is_known(text: str, estimates: np.ndarray) -> bool:
    """Whether a number and its interval are one of the estimates, rounded once or twice."""
    numbers = [x.replace(",", "") for x in ESTIMATE.findall(text)[0]]
    unit = 10.0 ** -max(len(x.partition(".")[2]) for x in numbers)
    apart = np.abs(estimates - np.array(numbers, dtype=float))
    return bool((apart <= 0.551 * unit).all(axis=1).any())


def of_row(row: ArmRow) -> list[Estimate]:
    found = [(row.mean, row.mean_interval), (row.iqm, row.iqm_interval), row.ratio, row.improvement]
    return [x for x in found if x is not None]


def of_claim(row: ClaimRow) -> list[Estimate]:
    """A claim's number and interval; a sentence may say the same the other way round."""
    if row.number is None or row.interval is None:
        return []
    low, high = row.interval
    return [(row.number, row.interval), (-row.number, (-high, -low))]


def estimates(names: list[str]) -> np.ndarray:
    """All estimates of some studies, a number and its interval a row."""
    found: list[Estimate] = []
    for name in names:
        tables = summary(name)
        found += [x for rows in tables.panels.values() for row in rows for x in of_row(row)]
        found += [x for claim in tables.claims for x in of_claim(claim)]
        found += [(row.iqm, row.iqm_interval) for row in tables.over_tasks]
    return np.array([(number, *interval) for number, interval in found])


def sections(page: str, level: int) -> dict[str, str]:
    parts = re.split(rf"^#{{{level}}} (.+)$", (ROOT / page).read_text(), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def table_rows(text: str) -> Iterator[list[str]]:
    for line in text.splitlines():
        if line.startswith("|") and not line.startswith("|---"):
            yield [cell.strip().replace("**", "") for cell in line.strip("|").split(" | ")]


def studies_in(title: str, text: str) -> list[str]:
    """The studies whose command a section names, with every budget unless its title says the steps."""
    if "Claims of the paper" in title:
        return ["paper-paper"] if "8 M steps" in title else ["paper-half"]
    named = set(re.findall(r"planspace study (\w+)", text.replace("\n", " ")))
    return [name for name in STUDIES if name.rpartition("-")[0] in named]


@pytest.mark.parametrize("name", STUDIES)
def test_the_tables_of_a_study_follow_from_its_csv(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from planspace.study import report

    about = json.loads((RESULTS / "study" / name / "study.json").read_text())
    study = make_study(about["study"], about["budget"]).only(about["only"])
    monkeypatch.setattr(report, "save_figure", lambda *_: None)
    report.write_report(read_findings(study, RESULTS / "study"), tmp_path)
    drawn, kept = ((folder / name / "tables.md").read_text() for folder in (tmp_path, RESULTS / "study"))
    assert without_figures(drawn) == without_figures(kept)


def without_figures(markdown: str) -> list[str]:
    return [line for line in markdown.splitlines() if line and not line.startswith("![")]


def test_estimates_in_the_docs_of_studies() -> None:
    checked = 0
    for title, text in sections("docs/appendix/studies.md", 2).items():
        known = estimates(studies_in(title, text))
        for found in ESTIMATE.finditer(text):
            assert is_known(found[0], known), f"{title}: {found[0]}"
            checked += 1
    assert checked >= 150


SUMMARIES = [("README.md", "Results", 9), ("docs/studies.md", "What the studies found", 3)]


@pytest.mark.parametrize(("page", "title", "least"), SUMMARIES)
def test_estimates_in_summaries(page: str, title: str, least: int) -> None:
    text = sections(page, 2)[title]
    found = [match[0] for match in ESTIMATE.finditer(text)]
    assert len(found) >= least
    known = estimates(STUDIES)
    assert [text for text in found if not is_known(text, known)] == []


def test_claims_in_the_docs_have_their_number_and_verdict() -> None:
    checked = 0
    for title, text in sections("docs/appendix/studies.md", 2).items():
        claims = {c.claim.text: c for name in studies_in(title, text) for c in summary(name).claims}
        for claim, rule, number, verdict in (row for row in table_rows(text) if len(row) == 4):
            row = claims.get(claim.removesuffix(" †"))
            if row is not None and row.number is not None and row.interval is not None:
                assert number == written((row.number, row.interval), 2), claim
                assert (rule, verdict) == (row.rule, row.verdict), claim
                assert claim.endswith(" †") == row.claim.late, claim
                checked += 1
    assert checked >= 37


@pytest.mark.parametrize(("page", "level"), [("docs/appendix/studies.md", 2), ("README.md", 2)])
def test_arms_in_the_docs_have_their_own_numbers(page: str, level: int) -> None:
    """Rows that begin with an arm's label: its mean, worst and best seed."""
    checked = 0
    for title, text in sections(page, level).items():
        arms = {
            row.arm: row
            for name in studies_in(title, text)[:1]
            for rows in summary(name).panels.values()
            for row in rows
        }
        for cells in table_rows(text):
            row = arms.get(cells[0])
            if row is not None and re.fullmatch(rf"{NUMBER}, {NUMBER}", cells[2] if len(cells) > 2 else ""):
                assert cells[1] == written((row.mean, row.mean_interval), 0), cells
                assert cells[2] == f"{row.worst:.0f}, {row.best:.0f}", cells
                checked += 1
    assert checked >= 2


@pytest.mark.parametrize("algo", ["TRPO", "PPO"])
def test_returns_of_all_tasks(algo: str) -> None:
    text = sections("docs/appendix/studies.md", 2)[f"Claims of the paper: {algo}, 1 M steps"]
    panels = summary("paper-half").panels
    rows = [cells for cells in table_rows(text) if f"{cells[0]}, {algo}" in panels]
    assert len(rows) == 4
    for task, *cells in rows:
        found = [written((row.mean, row.mean_interval), 1) for row in panels[f"{task}, {algo}"]]
        assert cells == found, task


def test_the_training_of_the_papers_embeddings() -> None:
    rows = read_rows(RESULTS / "study" / "paper-half" / "results.csv")
    text = sections("docs/appendix/studies.md", 2)["Claims of the paper: TRPO, 1 M steps"]
    ends = {}
    for row in rows:
        if row.metric.startswith("training_"):
            ends.setdefault((row.arm, row.metric), {}).setdefault(row.step, []).append(row.value)
    last = {key: steps[max(steps)] for key, steps in ends.items()}
    bounds = {
        f"{min(x):.1f} to {max(x):.1f}" for (_, metric), x in last.items() if metric == "training_bound"
    }
    errors = {
        f"{min(x):.3f} to {max(x):.3f}" for (_, metric), x in last.items() if metric != "training_bound"
    }
    checked = [cells for cells in table_rows(text) if re.match(r"(cart-pole|reacher), \d+", cells[0])]
    assert len(checked) == 4
    assert {cells[1] for cells in checked} == bounds and {cells[2] for cells in checked} == errors


def test_the_recipes_evaluations() -> None:
    text = sections("docs/appendix/studies.md", 2)["Recipe: reliability on the swing-up"]
    for name, label in (
        ("recipe-half", "the recipe's 75 policies after 1 M steps"),
        ("recipe-full", "after 2 M"),
    ):
        rows = read_rows(RESULTS / "study" / name / "results.csv")
        x = [
            r.value for r in rows if r.metric == "evaluation_return" and r.arm.endswith("recipe: sin/cos + z")
        ]
        assert len(x) == 75
        (found,) = (cells[1] for cells in table_rows(text) if cells[0] == label)
        assert found == f"{np.mean(x):.1f}; worst {min(x):.1f}, best {max(x):.1f}"


def test_core_seconds_of_the_papers_study() -> None:
    text = (ROOT / "docs" / "appendix" / "studies.md").read_text().replace("\n", " ")
    for name in ("paper-half", "paper-paper"):
        assert f"{summary(name).time.timed_core_seconds:,} core seconds" in text
    rows = [
        row
        for row in read_rows(RESULTS / "study" / "paper-half" / "results.csv")
        if "core_seconds" in row.metric
    ]
    assert rows and all(row.command.startswith("planspace study paper") and row.cpu for row in rows)


LEVELS = {
    "swing-up, raw, TRPO": "swingup-raw-trpo",
    "swing-up, sin/cos, TRPO": "swingup-trig-trpo",
    "swing-up, sin/cos, PPO": "swingup-trig-ppo",
    "CartPole, TRPO": "cartpole-raw-trpo",
    "CartPole, PPO": "cartpole-raw-ppo",
    "ReacherTrig, TRPO": "reacher-trig-trpo",
    "ReacherTrig, PPO": "reacher-trig-ppo",
    "ReacherRaw, TRPO": "reacher-raw-trpo",
}


def values(rows: list[Row], arm: str, metric: str) -> np.ndarray:
    return np.array([row.value for row in rows if (row.arm, row.metric) == (arm, metric)])


def test_levels_of_returns() -> None:
    rows = read_rows(RESULTS / "rl" / "levels.csv")
    paper, modern = sections("docs/appendix/training.md", 2)["Returns"].split("`modern` preset:")
    checked = 0
    for text, suffix in ((paper, ""), (modern, "-modern")):
        for cells in table_rows(text):
            if cells[0] not in LEVELS:
                continue
            arm = LEVELS[cells[0]] + ("-long" if cells[1] == "8 M" else suffix)
            last = values(rows, arm, "last_return")
            decimals = 0 if "swing-up" in cells[0] else 1
            error = last.std(ddof=1) / np.sqrt(len(last))
            assert cells[2].partition(";")[0] == f"{last.mean():.{decimals}f} ± {error:.{decimals}f}", arm
            assert cells[3] == f"{last.min():.{decimals}f}, {last.max():.{decimals}f}", arm
            assert cells[4] == f"{values(rows, arm, 'evaluation_return').mean():.{decimals}f}", arm
            checked += 1
    assert checked == 14


def test_the_long_training_of_the_reacher() -> None:
    rows = read_rows(RESULTS / "rl" / "levels.csv")
    own = [row for row in rows if row.arm == "reacher-trig-trpo-long" and row.metric == "return"]
    found = [
        np.mean([row.value for row in own if row.step == step]) for step in (1_440_000, 4_000_000, 8_000_000)
    ]
    text = sections("docs/appendix/training.md", 2)["Returns"].replace("\n", " ")
    assert "-9.9 at 1.44 M, -7.4 at 4 M and -6.6 at 8 M" in text
    assert [f"{x:.1f}" for x in found] == ["-9.9", "-7.4", "-6.6"]


@pytest.mark.usefixtures("benchmarks")
def test_tables_of_embeddings() -> None:
    import embedding_tables

    rows = read_rows(embedding_tables.FILE)
    arms = {row.arm for row in rows}
    known = {
        cell: arm
        for arm in arms
        if not arm.endswith("raw state")
        for cell in embedding_tables.table_row([row for row in rows if row.arm == arm])
    }
    text = sections("docs/appendix/embeddings.md", 2)["Geometry"]
    found = [match[0] for match in WITH_SEEDS.finditer(text)]
    assert len(found) > 120 and set(found) <= known.keys()
    planned = text.partition("released in 2020")[0]  # after it, the labels are of other demonstrations
    assert planned != text
    for cells in table_rows(planned):
        own = [row for row in rows if row.arm == cells[0]]
        if cells[0].endswith("raw state") and own:
            assert cells[1:] == [f"{row.value:.3f}" for row in own]
        elif own:
            assert cells[1:] == embedding_tables.table_row(own)


@pytest.mark.usefixtures("benchmarks")
def test_table_of_candidates() -> None:
    import embedding_ablation

    rows = read_rows(embedding_ablation.FILE)
    names = [name for name in embedding_ablation.CANDIDATES if any(row.arm == name for row in rows)]
    lines = embedding_ablation.table(names, rows)
    text = sections("docs/appendix/embeddings.md", 2)["Candidates"]
    shown = {cells[0]: cells for cells in table_rows(text) if cells[0] in names}
    assert len(shown) == len(names) == 38
    for cells in table_rows("\n".join(lines[2:])):
        of_docs = shown[cells[0]]
        assert of_docs[:9] == cells[:9], cells[0]
        ends = [[float(x) for x in re.findall(r"[-+]\d+", row[9])] for row in (cells, of_docs)]
        np.testing.assert_allclose(*ends, atol=BOOTSTRAP_NOISE, err_msg=cells[0])


def test_results_are_small_tables_and_the_figures_that_the_docs_show() -> None:
    kinds = (".csv", ".md", ".png")
    shipped = [file for file in RESULTS.rglob("*") if file.suffix in kinds]
    assert sum(file.stat().st_size for file in shipped) < MOST_BYTES
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    text = "".join(page.read_text() for page in pages if "_build" not in page.parts)
    for figure in (file for file in shipped if file.suffix == ".png"):
        assert str(figure.relative_to(ROOT)) in text, figure
