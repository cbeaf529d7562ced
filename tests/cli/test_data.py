"""Verbs that make, check and convert demonstrations."""

import json
from pathlib import Path

import pytest

from .calls import call


@pytest.mark.nightly
def test_from_plan_to_training(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    demos, embedding, run = tmp_path / "demos", tmp_path / "embedding", tmp_path / "run"
    plan = ["plan", "cartpole-swingup", "--num", 6, "--restarts", 1, "--workers", 1, "--out", demos]
    assert call(capsys, *plan)[0] == 0
    code, out, _ = call(capsys, "demos", "show", demos, "--json")
    assert code == 0 and json.loads(out)["demonstrations"] == 6
    code, out, _ = call(capsys, "demos", "validate", demos, "--replay", "--json")
    assert code == 0 and json.loads(out)["replay_error"] <= 1e-6
    assert call(capsys, "demos", "export", demos, tmp_path / "demos.npz")[0] == 0
    imported = ["demos", "import", tmp_path / "demos.npz", "--problem", "cartpole-swingup"]
    assert call(capsys, *imported, "--out", tmp_path / "back")[0] == 0
    assert call(capsys, "demos", "validate", tmp_path / "back", "--replay")[0] == 0
    assert call(capsys, "demos", "plot", demos, "--out", tmp_path / "plot")[0] == 0
    assert (tmp_path / "plot" / "demos.svg").exists()
    code, out, _ = call(capsys, "embed", demos, "--out", embedding, "--steps", 50, "--seeds", 2)
    assert code == 0 and "straightness" in out
    code, out, _ = call(capsys, "measure", embedding, tmp_path / "back", "--json")
    for part in json.loads(out)["splits"].values():
        assert {"straightness", "speed_variation", "midpoint_error"} < set(part["embedding"])
        assert set(part["constant"]) == set(part["raw_state"]) == set(part["embedding"])
    train = ["train", "cartpole-swingup", "--obs", "trig", "--z", "augment", "--embedding", embedding]
    code, out, err = call(capsys, *train, "--seeds", 2, "--steps", 4001, "--out", run)
    assert code == 0 and "--steps 4001 is rounded up to 8000, for whole iterations" in err
    for name in ("return, last iteration", "return, evaluation", "% at the goal, evaluation"):
        assert f"{name:<27}mean " in out
    assert (run / "curve.svg").exists()
    assert call(capsys, "curves", run, run, "--out", tmp_path / "curves")[0] == 0
    assert (tmp_path / "curves" / "curves.png").exists()


def test_recordings_come_in_and_go_out_as_csv(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for name, last in (("a", "0.2"), ("b", "0.3")):
        (tmp_path / f"{name}.csv").write_text(f"t,pos,speed,push\n0,1,2,3\n0.1,4,5,6\n{last},7,8,9\n")
    sources = [tmp_path / "a.csv", tmp_path / "b.csv", "--state", "x=pos", "--state", "v=speed"]
    command = ["demos", "import", *sources, "--control", "u=push", "--out", tmp_path / "demos"]
    code, out, err = call(capsys, *command)
    assert (code, out) == (0, f"2 demonstrations in {tmp_path}/demos\n")
    assert [line.split()[:2] for line in err.splitlines()[:-1]] == [
        ["column", "kind"],
        ["t", "time"],
        ["pos", "state"],
        ["speed", "state"],
        ["push", "control"],
    ]
    assert err.endswith("resampled 1 of 2 demonstrations to a step of 0.1 s\n")
    code, out, _ = call(capsys, "demos", "show", tmp_path / "demos", "--json")
    shown = json.loads(out)
    assert shown["state"] == {"x": "", "v": ""} and shown["controls"] == 1
    assert shown["made_by"] == {"imported": "a.csv and 1 more"}
    assert call(capsys, "demos", "export", tmp_path / "demos", tmp_path / "all.csv")[0] == 0
    header, first, *_ = (tmp_path / "all.csv").read_text().splitlines()
    assert (header, first) == ("episode,time,x,v,control1", "0,0.0,1.0,2.0,3.0")
    assert call(capsys, "demos", "import", tmp_path / "all.csv", "--out", tmp_path / "back")[0] == 0
    hashes = [
        json.loads(call(capsys, "demos", "show", tmp_path / n, "--json")[1])["hash"]
        for n in ("demos", "back")
    ]
    assert hashes[0] == hashes[1]


def test_a_bad_cell_is_one_line_and_nothing_is_written(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text("time,x\n0,1\n1,oops\n")
    code, out, err = call(capsys, "demos", "import", tmp_path / "a.csv", "--out", tmp_path / "demos")
    assert (code, out) == (1, "") and not (tmp_path / "demos").exists()
    place = f"planspace: {tmp_path}/a.csv, line 3: column 'x' must be a finite number, got 'oops'."
    assert err == f"{place} Correct it, or leave the column out with --drop 'x'.\n"


def test_a_film_from_the_command_line(
    capsys: pytest.CaptureFixture[str], demo_folder: Path, tmp_path: Path
) -> None:
    film = tmp_path / "film.gif"
    code, _, err = call(capsys, "demos", "render", demo_folder, "--out", tmp_path / "film.avi")
    assert code == 2 and "FILE.gif or FILE.mp4" in err
    small = ["--episodes", 1, "--fps", 10, "--width", 48, "--height", 32, "--camera", "side"]
    code, out, err = call(capsys, "demos", "render", demo_folder, "--out", film, *small)
    if "no OpenGL backend works here" in err:
        assert code == 1 and len(err.strip().splitlines()) == 1
        pytest.skip("no OpenGL backend works here")
    assert (code, out) == (0, f"{film}\n") and film.read_bytes()[:4] == b"GIF8"


def test_an_altered_shard_is_named(capsys: pytest.CaptureFixture[str], demos, tmp_path: Path) -> None:
    from planspace.demos.folder import DemoFolder

    DemoFolder(tmp_path, demos.info, {}).append([demos.episode(0)], 1)
    shard = tmp_path / "shard-00000.safetensors"
    shard.write_bytes(shard.read_bytes()[:-1] + b"!")
    code, _, err = call(capsys, "demos", "validate", tmp_path)
    assert code == 1 and "shard-00000.safetensors was altered or damaged" in err
