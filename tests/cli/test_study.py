"""Tests of `planspace study`."""

from pathlib import Path

import pytest

from planspace.cli import main


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 2, "which study? Choose one of paper, controls, demos, shaping, recipe, uses."),
        (["controle"], 2, "unknown study 'controle'. Did you mean 'controls'? Known:"),
        (["paper", "--budget", "ful"], 2, "unknown budget 'ful'. Did you mean 'full'? Known:"),
        (["paper", "--seeds", "7"], 2, "`--seeds` must be a positive multiple of 5, got 7."),
        (["paper", "--seeds", "0"], 2, "`--seeds` must be a positive multiple of 5, got 0."),
        (
            ["paper", "--only", "nothing"],
            2,
            "no arm of study paper has 'nothing' in its name. Its arms: cartpole,",
        ),
        (["paper", "--workers", "-1"], 2, "`--workers` must be 0 or more, got -1."),
        (
            ["paper", "--ray", "here"],
            2,
            "`--ray` must be HOST:PORT, as `ray start --head` prints it, got 'here'.",
        ),
        (["paper", "--report"], 1, "no arm of study paper has been run in"),
        (["paper", "--shard", "0/3"], 2, "`--shard` must be I/N with I from 1 to N, such as 2/3, got '0/3'."),
        (
            ["paper", "--shard", "1/200"],
            2,
            "study paper cannot be divided into 200 shards: it has only 108 units of policies.",
        ),
        (["paper", "--shard", "1/3", "--report"], 2, "--report and --shard cannot be used together."),
        (["paper", "--slurm", "0"], 2, "`--slurm` must be at least 1, got 0."),
        (["paper", "--slurm", "2", "--ray", "h:1"], 2, "--ray and --slurm cannot be used together."),
        (["paper", "--merge"], 2, "`--merge` needs the folders of the shards."),
        (["paper", "--merge", "nowhere"], 1, "nowhere is not a shard of a study: it has no shard.json."),
    ],
)
def test_wrong_arguments_are_rejected(
    arguments: list[str], code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", *arguments, "--out", str(tmp_path / "out")]) == code
    error = capsys.readouterr().err.strip()
    assert error.startswith(f"planspace: {message}") and "\n" not in error
    assert not (tmp_path / "out" / "units").exists()


def test_failed_units_are_listed_even_without_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from planspace.study import run

    monkeypatch.setattr(run, "run_study", lambda study, out, workers: {study.arms[0].units[0].name: "lost"})
    assert main(["study", "paper", "--only", "cartpole, TRPO/raw", "--out", str(tmp_path)]) == 3
    error = capsys.readouterr().err
    assert "1 unit failed" in error and "(cartpole, TRPO/raw): lost." in error
