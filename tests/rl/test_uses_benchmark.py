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
    for use in uses.ARMS.values():
        config = uses.settings_of(use, options, 300, 5)
        check_uses_of_plans(config)
        assert config.needs_embedding == bool(use.encoder) and list(config.seeds) == [*range(300, 305)]
    assert {name for _, *pair in uses.CLAIMS for name in pair} <= set(uses.ARMS)
    assert not set(options.arms) - set(uses.ARMS)


def test_an_algorithm_without_a_replay_buffer_has_no_arms_that_replay(uses: Any) -> None:
    assert uses.options_of(["acrobot-swingup", "--algo", "trpo"]).arms == ["none", "resets", "guide"]
    with pytest.raises(UsageError, match="unknown algorithm"):
        uses.options_of(["acrobot-swingup", "--algo", "td4"])


def test_finished_units_are_kept_and_claims_follow_from_the_rows(
    uses: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("dm_control", reason="needs the extra robots")
    level, calls = {"none": 0.0, "resets": 300.0, "replay": 10.0}, []

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
    assert "starting at plans helps: holds: 300.0 (300.0, 300.0)." in printed
    assert "replaying plans helps: does not hold: 10.0" in printed  # the margin is 5 % of 1000
    uses.main(arguments)
    assert len(calls) == 6 and capsys.readouterr().out == printed[printed.index("| arm") :]


def test_the_table_in_the_docs_follows_from_the_rows(uses: Any) -> None:
    options = uses.options_of(["acrobot-swingup", "--steps", "30000"])
    text = (Path(__file__).parents[2] / "docs" / "training.md").read_text()
    lines = [line for line in uses.table(uses.read_rows(uses.FILE), options) if line.startswith("|")]
    assert len(lines) > 3 and [line for line in lines if line not in text] == []
