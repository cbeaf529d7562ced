"""benchmarks/uses.py: a valid grid, units that are run once, and claims that follow from the rows."""

import importlib
from pathlib import Path
from typing import Any

import pytest

from planspace.errors import UsageError
from planspace.rl.checks import check_uses_of_plans


@pytest.fixture
def uses(benchmarks: None) -> Any:
    return importlib.import_module("uses")


def test_every_arm_is_a_valid_setting_and_every_claim_is_about_arms(uses: Any) -> None:
    options = uses.options_of(["acrobot-swingup", "--steps", "9000"])
    for use in options.ways.values():
        config = uses.settings_of(use, options, 300, 5)
        check_uses_of_plans(config)
        assert config.needs_embedding == bool(use.objective) and list(config.seeds) == [*range(300, 305)]
    assert options.arms == list(options.ways)


def test_an_algorithm_without_a_replay_buffer_has_no_arms_that_replay(uses: Any) -> None:
    arms = uses.options_of(["acrobot-swingup", "--algo", "trpo"]).arms
    assert "resets + z" in arms and "replay" not in arms
    with pytest.raises(SystemExit):
        uses.options_of(["acrobot-swingup", "--algo", "trpo", "--arms", "replay"])
    with pytest.raises(UsageError, match="unknown algorithm"):
        uses.options_of(["acrobot-swingup", "--algo", "td4"])


def test_finished_units_are_kept_and_claims_follow_from_the_rows(
    uses: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("dm_control", reason="needs the extra robots")
    level, calls = {"no plans": 0.0, "resets": 300.0, "replay": 10.0}, []

    def run_unit(arm: str, seeds: range, options: Any) -> list[dict[str, str]]:
        calls.append((arm, seeds[0]))
        key = dict(
            zip(uses.COLUMNS, ("dmc:acrobot-swingup", "sac", uses.unit_name(options), arm), strict=False)
        )
        rows = [(seed, step) for seed in seeds for step in (1000, 2000)]
        return [
            {
                **key,
                "seed": str(seed),
                "step": str(step),
                "eval_return": f"{level[arm] + step / 1000 + seed % 5}",
            }
            for seed, step in rows
        ]

    monkeypatch.setattr(uses, "run_unit", run_unit)
    arguments = [
        "dmc:acrobot-swingup",
        "--file",
        str(tmp_path / "uses.csv"),
        "--seeds",
        "10",
        "--arms",
        *level,
    ]
    uses.main(arguments)
    assert calls == [(arm, start) for start in (300, 305) for arm in level]
    printed = capsys.readouterr().out
    assert "| resets | 10 | 304.0 (302.0, 306.0) | 303.5 |" in printed  # 300 + 2 + the mean of 0 to 4
    assert "| starting at plans helps | holds | 300.0 (300.0, 300.0) |" in printed
    assert "| replaying plans helps | does not hold | 10.0" in printed  # the margin is 5 % of 1000
    uses.main(arguments)
    assert len(calls) == 6 and capsys.readouterr().out == printed[printed.index("| arm") :]


@pytest.mark.parametrize(
    ("arguments", "shown"),
    [
        (("acrobot-swingup", "--steps", "100000"), "`acrobot-swingup` | SAC | 100,000"),
        (("acrobot-swingup", "--algo", "trpo", "--steps", "1000000"), "`acrobot-swingup` | TRPO | 1,000,000"),
        (
            ("dmc:acrobot-swingup", "--steps", "200000", "--action-repeat", "2"),
            "`dmc:acrobot-swingup` | SAC | 200,000",
        ),
    ],
)
def test_the_table_of_acrobots_in_the_docs_follows_from_the_rows(
    uses: Any, arguments: tuple[str, ...], shown: str
) -> None:
    if arguments[0].startswith("dmc:"):
        pytest.importorskip("dm_control", reason="needs the extra robots")
    text = (Path(__file__).parents[2] / "docs" / "training.md").read_text()
    in_docs = [line for line in text.splitlines() if line.startswith(f"| {shown} |")]
    found = uses.table(uses.read_rows(uses.FILE), uses.options_of(arguments))
    arms = found[2 : found.index("")]  # below the head of the first table
    cells = [line.strip("|").split("|")[:3] for line in arms]
    assert len(cells) == len(in_docs)
    for arm, seeds, last in cells:
        assert any(line.endswith(f"|{arm}|{seeds}|{last}|") for line in in_docs), arm
