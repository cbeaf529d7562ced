"""The verb `study`."""

from pathlib import Path

import pytest

from planspace.cli import main


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        ([], 2, "which study? Choose one of paper, controls, demos, shaping, recipe."),
        (["controle"], 2, "unknown study 'controle'. Did you mean 'controls'? Known:"),
        (["paper", "--budget", "ful"], 2, "unknown budget 'ful'. Did you mean 'full'? Known:"),
        (["paper", "--seeds", "7"], 2, "seeds come in blocks of 5, got --seeds 7."),
        (["paper", "--only", "nothing"], 2, "study paper has no arm like nothing. Its arms: cartpole,"),
        (["paper", "--workers", "-1"], 2, "`--workers` must be 0 or more, got -1."),
        (
            ["paper", "--ray", "here"],
            2,
            "--ray takes HOST:PORT, as `ray start --head` prints it, got 'here'.",
        ),
        (["paper", "--report"], 1, "no arm of study paper has been run in"),
    ],
)
def test_a_study_that_cannot_be_is_refused(
    arguments: list[str], code: int, complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", *arguments, "--out", str(tmp_path / "out")]) == code
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"planspace: {complaint}") and "\n" not in said
    assert not (tmp_path / "out" / "units").exists()


def test_failed_units_of_a_study_are_listed_even_if_nothing_else_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from planspace.study import run

    monkeypatch.setattr(run, "run_study", lambda study, out, workers: {study.arms[0].units[0].name: "lost"})
    assert main(["study", "paper", "--only", "cartpole, TRPO/raw", "--out", str(tmp_path)]) == 3
    said = capsys.readouterr().err
    assert "1 units failed" in said and "(cartpole, TRPO/raw): lost." in said
