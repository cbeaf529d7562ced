import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.cli import main
from planspace.storage.files import read_sealed, write_sealed

VERBS = [
    "run",
    "plan",
    "demos",
    "embed",
    "measure",
    "export",
    "train",
    "curves",
    "play",
    "study",
    "report",
    "repair",
    "doctor",
]


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def unboxed(err: str) -> str:
    """The text inside tyro's box, on one line."""
    return " ".join(re.sub(r"[╭╮╰╯─│•]|-{3,}", " ", err).split())


@pytest.mark.parametrize("verb", [[], *[[v] for v in VERBS], ["demos", "import"], ["demos", "render"]])
def test_help_says_what_each_option_is(verb: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = call(capsys, *verb, "--help")
    assert code == 0
    assert "usage: planspace" in out
    assert not re.search(r"--[a-z-]+ [A-Z.|]+\s+\(default", out)  # no option without a word of its own


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "carpole"], "unknown task 'carpole'. Did you mean 'cartpole'?"),
        (["run", "--budgt", "small"], "Unrecognized options: --budgt, small Perhaps you meant: --budget"),
        (["run", "--budget", "tiny"], "invalid choice 'tiny'"),
        (["rnu"], "Available subcommands: run, plan"),
        (["plan", "--out", "x"], "which problem? Shipped: acrobot, arm, "),
        (["plan", "reachr", "--out", "x"], "Did you mean 'reacher'?"),
        (["plan", "reacher", "--num", "0", "--out", "x"], "--num must be at least 1; --restarts, "),
        (["plan", "reacher", "--planner", "ompl-rtt", "--out", "x"], "Did you mean 'ompl-rrt'?"),
        (
            ["plan", "reacher", "--planner", "ompl-prm", "--out", "x"],
            "ompl-prm cannot plan a dynamic problem",
        ),
        (["plan", "reacher", "--settings", "min_rounds", "--out", "x"], "takes KEY=VALUE with a number"),
        (["plan", "reacher", "--settings", "min_round=4", "--out", "x"], "Did you mean 'sst_min_rounds'?"),
        (["plan", "reacher", "--workers", "-1", "--out", "x"], "--workers and --seed must not be negative"),
        (["plan", "reacher", "--settings", "restarts=0", "--out", "x"], "restarts must be at least 1"),
        (["plan", "reacher", "--cost", "speed", "--out", "x"], "unknown cost 'speed'"),
        (["train", "--out", "x"], "which task? There are acrobot-swingup, arm, cartpole"),
        (["train", "cartpole", "--z", "augment", "--out", "x"], "give --embedding DIR"),
        (["demos", "import", "--out", "x"], "which source? It may be FILE.npz, FILE.csv, minari:ID"),
        (["demos", "import", "demos.txt", "--out", "x"], "demos.txt is no source of demonstrations"),
        (["demos", "import", "a.csv", "--state", "x", "--out", "x"], "--state needs NAME=COLUMN, got 'x'"),
        (["demos", "import", "a.csv", "--dt", "0", "--out", "x"], "--dt must be a positive number"),
        (["demos", "import", "a.out", "--out", "x"], "give --problem"),
        (["measure"], "Missing from planspace measure: EMBEDDING"),
        (["curves", "--out", "x"], "which runs? Give the folders that `planspace train` made"),
        (["train", "cartpole", "--z-to", "critic", "--out", "x"], "z_to is 'critic', but there is no z"),
        (["train", "cartpole", "--seed", "-1", "--out", "x"], "seeds are at least 0, got -1"),
        (["train", "cartpole", "--hidden", "0", "--out", "x"], "layers of at least one unit"),
        (["play", "x", "--video", "x.txt"], "x.txt is no film; give FILE.gif or FILE.mp4"),
        (["export", "e"], "Missing from planspace export: FILE"),
        (["export", "e", "e.onnx", "--to", "torch"], "invalid choice 'torch'"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = call(capsys, *arguments)
    assert code == 2
    assert message in unboxed(err)
    assert out == "" and ("For full helptext" in err or len(err.strip().splitlines()) == 1)
    assert list(tmp_path.iterdir()) == []  # nothing half-written


def test_a_failure_is_one_line_and_exit_code_1_and_debug_shows_more(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, _, err = call(capsys, "demos", "show", tmp_path / "nowhere")
    assert code == 1
    assert err.strip() == f"planspace: {tmp_path}/nowhere is not a demo dataset: it has no manifest.json."
    code, _, err = call(capsys, "demos", "show", tmp_path / "nowhere", "--debug")
    assert code == 1 and "Traceback" in err


def test_an_out_folder_that_cannot_be_written(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    code, _, err = call(capsys, "run", "--budget", "smoke", "--out", tmp_path / "file" / "run")
    assert code == 1
    assert "cannot write" in err and "Not a directory" in err and len(err.strip().splitlines()) == 1


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
    assert code == 0 and "--steps 4001 rounded to 8000" in err
    assert "return, last iteration  mean " in out and "return, evaluation      mean " in out
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
    assert err == "resampled 1 of 2 demonstrations to a step of 0.1 s\n"
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
    assert (
        err == f"planspace: {tmp_path}/a.csv, line 3: column 'x' holds 'oops', which is no finite number.\n"
    )


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


def test_measuring_other_demos_names_both(
    capsys: pytest.CaptureFixture[str], embedding_folder: Path, tmp_path: Path
) -> None:
    np.savez(
        tmp_path / "other.npz",
        states=np.random.default_rng(0).normal(size=(40, 2)),
        controls=np.zeros((40, 1)),
        time=np.arange(40) * 0.1,
        offsets=[0, 40],
    )
    assert call(capsys, "demos", "import", tmp_path / "other.npz", "--out", tmp_path / "other")[0] == 0
    code, _, err = call(capsys, "measure", embedding_folder, tmp_path / "other")
    assert code == 1 and "(slider, hinge, slidervel, hingevel)" in err and "(state0, state1)" in err


def test_measuring_draws_the_figures(
    capsys: pytest.CaptureFixture[str], embedding_folder: Path, demo_folder: Path, tmp_path: Path
) -> None:
    pictures, truth = tmp_path / "deep" / "pictures", tmp_path / "truth.npz"
    np.savez(truth, states=np.eye(4), time=np.arange(4.0), goal=np.zeros(4))
    command = ["measure", embedding_folder, demo_folder, "--plot", pictures, "--truth", truth]
    code, out, _ = call(capsys, *command)
    for said in ("train  ", "validation  ", "test  ", "95 % interval", "raw state", "true_time_correlation"):
        assert said in out
    assert code == 0 and re.search(rf"^figures +{re.escape(str(pictures))}$", out, flags=re.MULTILINE)
    names = [f"{name}.{ending}" for name in ("distance", "paths", "training") for ending in ("png", "svg")]
    assert sorted(f.name for f in pictures.iterdir()) == sorted([*names, "paths.html"])
    assert all(f.read_bytes()[1:4] == b"PNG" for f in pictures.glob("*.png"))
    page = (pictures / "paths.html").read_text()
    assert "<title>A demonstration of cartpole-swingup in plan space" in page  # the test split has one


def test_other_demos_are_drawn_whole_and_json_stays_json(
    capsys: pytest.CaptureFixture[str], embedding_folder: Path, demos, tmp_path: Path
) -> None:
    from planspace.demos.folder import DemoFolder

    DemoFolder(tmp_path / "other", demos.info, {}).append([demos.episode(i) for i in (0, 1, 2)], 3)
    shutil.copytree(embedding_folder, tmp_path / "e", ignore=shutil.ignore_patterns("log.jsonl"))
    command = ["measure", tmp_path / "e", tmp_path / "other", "--plot", tmp_path / "p", "--json"]
    code, out, _ = call(capsys, *command)
    assert code == 0 and json.loads(out)["figures"] == str(tmp_path / "p")
    assert "<title>3 demonstrations of" in (tmp_path / "p" / "paths.html").read_text()
    assert not (tmp_path / "p" / "training.png").exists()  # there is no log to draw
    (tmp_path / "file").touch()
    code, out, err = call(capsys, *command[:3], "--plot", tmp_path / "file")
    assert (code, out) == (1, "") and "cannot write" in err and len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("row", "seeds", "blamed"),
    [
        ({"step": 1, "path_error": "small", "bound": 1}, [0, 1], "log.jsonl"),
        ({"step": 1, "path_error": [1, 2], "bound": [[1], [2]]}, [0, 1], "log.jsonl"),
        ({"step": 1, "path_error": [1, 2], "bound": [1, 2]}, [0], "log.jsonl"),
        ({"step": 1, "path_error": [1, 2], "bound": [1, 2]}, [7, 8], "embedding.json"),
        ({"step": 1, "path_error": [1, 2], "bound": [1, 2]}, 3, "embedding.json"),
    ],
)
def test_a_log_that_lies_is_named_before_anything_is_drawn(
    row: dict,
    seeds: Any,
    blamed: str,
    capsys: pytest.CaptureFixture[str],
    embedding_folder: Path,
    demo_folder: Path,
    tmp_path: Path,
) -> None:
    folder = shutil.copytree(embedding_folder, tmp_path / "e")
    about = read_sealed(folder / "embedding.json")
    settings = about["about"]["settings"] | {"seeds": seeds}
    write_sealed(folder / "embedding.json", about | {"about": about["about"] | {"settings": settings}})
    (folder / "log.jsonl").write_text(json.dumps(row) + "\n")
    code, out, err = call(capsys, "measure", folder, demo_folder, "--plot", tmp_path / "p")
    assert (code, out) == (1, "") and list(tmp_path.glob("p/*")) == []
    (line,) = [line for line in err.splitlines() if line.startswith("planspace: ")]
    assert str(folder / blamed) in line and "planspace repair" in line


def test_an_embedding_goes_out_as_onnx(
    capsys: pytest.CaptureFixture[str], embedding_folder: Path, tmp_path: Path
) -> None:
    onnx = pytest.importorskip("onnx")
    file = tmp_path / "e.onnx"
    assert call(capsys, "export", embedding_folder, file, "--to", "onnx") == (0, f"{file}\n", "")
    assert [output.name for output in onnx.load(file).graph.output] == ["mu", "sigma"]
    code, out, err = call(capsys, "export", embedding_folder, file)
    assert (code, out) == (1, "")
    assert err == f"planspace: {file} exists already; choose another file, or remove it first.\n"


def test_help_imports_nothing_heavy() -> None:
    heavy = ("onnx", "onnxruntime", "tensorboard", "matplotlib", "plotly", "jax")
    code = "import sys; from planspace.cli import main; main(['measure', '--help']); "
    code += f"print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_an_altered_shard_is_named(capsys: pytest.CaptureFixture[str], demos, tmp_path: Path) -> None:
    from planspace.demos.folder import DemoFolder

    DemoFolder(tmp_path, demos.info, {}).append([demos.episode(0)], 1)
    shard = tmp_path / "shard-00000.safetensors"
    shard.write_bytes(shard.read_bytes()[:-1] + b"!")
    code, _, err = call(capsys, "demos", "validate", tmp_path)
    assert code == 1 and "shard-00000.safetensors was altered or damaged" in err


def test_doctor_examines_this_machine(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = call(capsys, "doctor", "--json")
    findings = json.loads(out)
    assert code == 0
    assert findings["mujoco.batch"]["ok"] and findings["[test]"]["ok"]
    assert all(f["ok"] or f["advice"] for f in findings.values())  # a line of advice for all that is missing
    code, out, _ = call(capsys, "doctor")
    assert code == 0 and len(out.strip().splitlines()) == len(findings)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    import planspace

    assert call(capsys, "--version")[1].strip() == planspace.__version__


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_ctrl_c_stops_cleanly_and_the_same_command_continues(tmp_path: Path) -> None:
    heed = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # ignored in the background
    )
    start = f"{heed}; from planspace.cli import main; raise SystemExit(main())"
    command = [sys.executable, "-c", start, "train", "cartpole-swingup", "--seeds", "1"]
    command += ["--steps", "400000", "--out", str(tmp_path / "run")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    checkpoint = tmp_path / "run" / "checkpoint" / "state.safetensors"
    deadline = time.monotonic() + 60
    while not checkpoint.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.strip().endswith("interrupted; the same command continues from here.")
    done = len((tmp_path / "run" / "log.jsonl").read_text().splitlines())
    assert 10 <= done < 100
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    rows = [json.loads(row) for row in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert [row["iteration"] for row in rows] == list(range(1, 101))  # none lost, none twice


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


def test_repair_says_what_it_found(
    demo_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(demo_folder, tmp_path / "demos")
    assert call(capsys, "repair", folder) == (0, f"nothing in {folder} is damaged.\n", "")
    (folder / "shard-00001.safetensors").write_bytes(b"")
    code, out, _ = call(capsys, "repair", folder)
    assert code == 0 and "shard-00001.safetensors was altered or damaged" in out
    assert "The command that made them, run again" in out
    assert call(capsys, "demos", "validate", folder)[0] == 0


def test_names_of_strangers_move_no_cursor(
    demo_folder: Path, embedding_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(demo_folder, tmp_path / "demos")
    manifest = read_sealed(folder / "manifest.json")
    manifest["info"] |= {"names": ["\x1b[2Jx", "two\nlines", "θ", "d"], "problem": "\x1b]0;title\x07"}
    manifest["settings"]["planner"] = {"\x1b[31m": "\x9b"}
    write_sealed(folder / "manifest.json", manifest)
    code, out, _ = call(capsys, "demos", "show", folder)
    assert code == 0 and all(line.isprintable() for line in out.split("\n"))
    for shown in (r"\x1b[2Jx ", r"two\nlines ", "θ ", r"\x1b]0;title\x07", r"\x1b[31m", r"\x9b"):
        assert shown in out
    for debug in ([], ["--debug"]):
        code, _, err = call(capsys, "measure", embedding_folder, folder, *debug)
        assert code == 1 and r"(\x1b[2Jx, two\nlines, θ, d)" in err
        assert all(line.isprintable() for line in err.split("\n"))
        assert debug or len(err.splitlines()) == 1


def test_too_little_memory_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("planspace.cli.doctor.examine", full)
    assert main(["doctor"]) == 1
    assert capsys.readouterr().err == "planspace: not enough memory for this command.\n"
