"""The tables about planning and pixels in the docs are those of results/."""

import csv
import importlib

import pytest

from planspace import load_embedding

from .test_numbers import RESULTS, sections, table_rows

NOT_SHOWN = ("reads", "target", "seed", "steps", "rounds", "pictures", "demos", "episodes")
"""Columns of results/pixels that the tables name otherwise, or not at all."""


def test_table_of_models_that_others_wrote() -> None:
    with open(RESULTS / "planning" / "foreign_models.csv") as file:
        known = {row["problem"]: row for row in csv.DictReader(file)}
    section = sections("docs/appendix/planning.md", 2)["Models that others wrote"]
    rows = [row for row in table_rows(section) if row[0] != "problem"]
    assert {row[0] for row in rows} == known.keys() and len(rows) >= 20
    for name, _, settings, solved, seconds, duration, error in rows:
        wanted = [
            known[name][k] for k in ("settings", "solved", "seconds_per_plan", "duration_s", "replay_error")
        ]
        assert [settings, solved, seconds, duration, error] == wanted, name


@pytest.mark.usefixtures("benchmarks")
def test_table_of_dynobench() -> None:
    import dynobench_problems as script

    section = sections("docs/appendix/planning.md", 2)["Comparison with iDb-A*"]
    tuned = [row for row in script.read_rows(script.RESULTS) if row["settings"]]
    default = [row for row in script.read_rows(script.RESULTS) if not row["settings"]]
    for rows in (default, tuned):
        assert len(rows) >= 20 and [line for line in script.table(rows) if line not in section] == []
    found, text = script.summaries(tuned).values(), section.replace("\n", " ")
    shorter, faster = (sum(getattr(x, key) for x in found) for key in ("shorter", "faster"))
    assert f"on {shorter} of {len(found)} problems" in text and f"recorded time on {faster}." in text


def test_tables_of_pixels() -> None:
    rows = {tuple(row) for row in table_rows((RESULTS.parent / "docs" / "pixels.md").read_text())}
    checked = 0
    for file in ("geometry.csv", "visited.csv"):
        with open(RESULTS / "pixels" / file) as table:
            for row in csv.DictReader(table):
                reads = f"`{row['target']}`" if row["target"] else "states"
                numbers = [x for name, x in row.items() if name not in NOT_SHOWN]
                assert (reads, row["rounds"], row["pictures"], *numbers) in rows, row
                checked += 1
    assert checked >= 7


@pytest.mark.usefixtures("benchmarks")
def test_table_of_pictures_alone() -> None:
    import pixels_alone
    from csv_rows import read_rows

    page = (RESULTS.parent / "docs" / "pixels.md").read_text()
    found = pixels_alone.table(read_rows(pixels_alone.RESULTS)).splitlines()
    assert len(found) >= 9 and [line for line in found if line not in page] == []


def test_plans_carried_out() -> None:
    with open(RESULTS / "control" / "plan_returns.csv") as file:
        found = list(csv.DictReader(file))
    page = RESULTS.parent / "docs" / "appendix" / "control.md"
    rows = {tuple(row) for row in table_rows(page.read_text())}
    for row in found:
        held = f"{float(row['held']):.0%}"
        spread = f"{row['return_worst']}, {row['return_best']}"
        assert ("plans and regulator", row["return_mean"], spread, held) in rows
    assert found


def test_returns_from_pixels() -> None:
    """A row of the table holds three policies and the controller, each of which may be missing."""
    rows = {tuple(row) for row in table_rows((RESULTS.parent / "docs" / "pixels.md").read_text())}
    with open(RESULTS / "pixels" / "returns.csv") as file:
        found = list(csv.DictReader(file))
    for row in found:
        reads = f"`{row['reads']}`" if row["pictures"] else "states"
        key = (reads, row["rounds"], row["pictures"], row["filter"].capitalize())
        (shown,) = [r for r in rows if r[:4] == key and len(r) == 9]
        if row["acts"] == "policy":
            assert shown[4 + int(row["policy_seed"])] == row["return_mean"]
        else:
            assert list(shown[7:]) == [row["return_mean"], row["success"]]
    assert len(found) >= 26


@pytest.mark.usefixtures("benchmarks")
def test_table_of_ways_to_use_plans() -> None:
    import uses

    section = (RESULTS.parent / "docs" / "training.md").read_text().partition("### Which way helps")[2]
    options = uses.options_of(["cartpole-swingup", "--reward", "sparse", "--steps", "30000"])
    rows = uses.read_rows(uses.FILE)
    found = uses.table(rows, options)
    assert len(found) > 12
    assert [line for line in found if line not in section] == []
    at_half = {
        arm: [
            float(row["eval_return"])
            for row in rows
            if (row["arm"], row["step"], row["settings"]) == (arm, "15000", uses.unit_name(options))
        ]
        for arm in ("no plans", "replay")
    }
    assert len(at_half["no plans"]) == len(at_half["replay"]) == 10
    least, most = min(at_half["replay"]), max(at_half["no plans"])
    for page in ("README.md", "docs/faq.md", "docs/training.md"):
        text = (RESULTS.parent / page).read_text()
        assert f" {least:.0f} " in text and f" {most:.0f}" in text


@pytest.mark.usefixtures("benchmarks")
@pytest.mark.parametrize(
    ("name", "page"),
    [
        ("control_ilqr", "appendix/control.md"),
        ("goals", "appendix/training.md"),
        ("control", "appendix/control.md"),
        ("shaping_scales", "appendix/training.md"),
        ("cloning", "appendix/training.md"),
        ("control_follow", "appendix/control.md"),
        ("dagger", "training.md"),
        ("door", "appendix/training.md"),
    ],
)
def test_the_table_of_a_benchmark_is_on_its_page(name: str, page: str) -> None:
    script, files = importlib.import_module(name), importlib.import_module("csv_rows")
    lines = script.table(files.read_rows(script.RESULTS)).splitlines()
    text = (RESULTS.parent / "docs" / page).read_text()
    assert len(lines) > 5
    assert [line for line in lines if line not in text] == []


def test_control_of_deepmind_controls_acrobot() -> None:
    rows = [
        tuple(row) for row in table_rows((RESULTS.parent / "docs" / "appendix" / "control.md").read_text())
    ]
    with open(RESULTS / "control" / "dmc_acrobot.csv") as file:
        found = list(csv.DictReader(file))
    for row in found:
        tried = {"way back": "shortest way back", "z": "nearest in z", "": "none"}[row["tried"]]
        settings = row["cost"], f"{row['horizon_s']} s", row["samples"], tried
        held = f"{float(row['success']):.0%}"
        assert (
            *settings,
            row["seed"],
            row["starts"],
            held,
            row["return_mean"],
            row["return_worst"],
        ) in rows, row
    chosen = ("z", "0.64", "way back")
    best = [row for row in found if (row["cost"], row["horizon_s"], row["tried"]) == chosen]
    assert len(found) > 5 and [int(row["starts"]) for row in best] == [20] * 4
    fresh = [row for row in best if row["seed"] != "0"]
    earned = sum(float(row["return_mean"]) for row in fresh) / len(fresh)
    held = sum(round(float(row["success"]) * int(row["starts"])) for row in fresh)
    assert f"{held} of 60 starts" in (RESULTS.parent / "README.md").read_text()
    for page in ("README.md", "docs/training.md", "docs/appendix/control.md"):
        assert f"earns {earned:.0f}" in (RESULTS.parent / page).read_text().replace("\n", " "), page


def test_control_of_two_poles() -> None:
    page = (RESULTS.parent / "docs" / "appendix" / "control.md").read_text()
    rows = [tuple(row) for row in table_rows(page)]
    with open(RESULTS / "control" / "two_poles.csv") as file:
        found = list(csv.DictReader(file))
    for row in found:
        following = f"{row['follow_s']} s" if int(row["follow_s"]) else "none"
        settings = row["cost"], f"{row['horizon_s']} s", following, row["seed"], row["starts"]
        held = f"{float(row['success']):.0%}"
        assert (*settings, held, row["return_mean"], row["return_worst"]) in rows, row
    assert len(found) == 8


def test_control_with_ready_made_embeddings() -> None:
    text = (RESULTS.parent / "docs" / "howto" / "ready-made.md").read_text()
    shown = {row[0].strip("`"): dict(zip(("z", "time"), row[3:5], strict=True)) for row in table_rows(text)}
    with open(RESULTS / "control" / "ready_made.csv") as file:
        found = list(csv.DictReader(file))
    assert len(found) > 5
    for row in found:
        assert shown[row["task"]][row["cost"]] == f"{float(row['success']):.0%}", row
        assert load_embedding(row["task"]).hash.startswith(row["embedding"])


def test_the_door_that_the_readme_tells_of() -> None:
    with open(RESULTS / "rl" / "door.csv") as file:
        found = [row for row in csv.DictReader(file) if (row["arm"], row["steps"]) == ("cloning", "1000000")]
    success = sorted(round(100 * float(row["success"])) for row in found)
    words = f"ten of ten seeds do in {success[0]} to {success[-1]} % of the episodes"
    assert len(found) == 10 and words in (RESULTS.parent / "README.md").read_text()
    assert words.replace(" do ", " open it ") in (RESULTS.parent / "docs" / "training.md").read_text()
