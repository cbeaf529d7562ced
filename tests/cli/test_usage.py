"""Help, wrong usage, and what every verb has in common."""

import json
import os
import re
import shutil
import subprocess
import sys
from email.message import Message
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from planspace.cli import main
from planspace.cli.doctor import examine
from planspace.cli.entry import VERBS

from .calls import call, unboxed


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
        (["run", "--seed", "-1"], "`--seed` must be at least 0, got -1."),
        (["run", "--budget", "tiny"], "invalid choice 'tiny'"),
        (["rnu"], "Available subcommands: run, plan"),
        (["plan"], "which problem? One of acrobot, arm, "),
        (["plan", "reacher"], "`--out DIR` is required"),
        (["plan", "reachr", "--out", "x"], "Did you mean 'reacher'?"),
        (["plan", "reacher", "--num", "0", "--out", "x"], "`--num` must be at least 1, got 0."),
        (["plan", "reacher", "--planner", "ompl-rtt", "--out", "x"], "Did you mean 'ompl-rrt'?"),
        (
            ["plan", "reacher", "--planner", "ompl-prm", "--out", "x"],
            "ompl-prm cannot plan a dynamic problem",
        ),
        (["plan", "reacher", "--settings", "min_rounds", "--out", "x"], "takes KEY=VALUE with a number, got"),
        (["plan", "reacher", "--settings", "min_round=4", "--out", "x"], "Did you mean 'sst_min_rounds'?"),
        (["plan", "reacher", "--workers", "-1", "--out", "x"], "`--workers` must be at least 0, got -1."),
        (
            ["plan", "reacher", "--settings", "restarts=0", "--out", "x"],
            "`restarts` must be at least 1, got 0.",
        ),
        (["plan", "reacher", "--cost", "speed", "--out", "x"], "invalid choice 'speed'"),
        (["train"], "which task? One of acrobot, acrobot-swingup, arm"),
        (["train", "cartpole"], "`--out DIR` is required"),
        (["embed"], "which demonstrations? Give a dataset folder"),
        (["train", "cartpole", "--algo", "tpro"], "unknown algorithm 'tpro'. Did you mean 'trpo'?"),
        (["train", "cartpole", "--algo", "ppo", "--max-kl", "1"], "Unrecognized options: --max-kl"),
        (["embed", "x", "--objective", "e2e"], "unknown objective 'e2e'. Did you mean 'e2c'?"),
        (["train", "cartpole", "--z", "augment", "--out", "x"], "give --embedding DIR"),
        (["demos", "import", "--out", "x"], "give a source to import: FILE.npz, FILE.csv, minari:ID"),
        (["demos", "import", "demos.txt", "--out", "x"], "demos.txt is not a source of demonstrations"),
        (["demos", "import", "a.csv", "--state", "x", "--out", "x"], "--state needs NAME=COLUMN, got 'x'"),
        (["demos", "import", "a.csv", "--dt", "0", "--out", "x"], "--dt must be a positive number"),
        (["demos", "import", "a.out", "--out", "x"], "give --problem"),
        (["measure"], "Missing from planspace measure: EMBEDDING"),
        (["curves", "--out", "x"], "which runs? Give the folders that `planspace train` made"),
        (["train", "cartpole", "--z-to", "critic", "--out", "x"], "z_to is 'critic', but there is no z"),
        (["train", "cartpole", "--seed", "-1", "--out", "x"], "`seed` must be at least 0, got -1"),
        (
            ["train", "cartpole", "--hidden", "0", "--out", "x"],
            "`hidden` needs at least one unit in each layer",
        ),
        (
            ["train", "cartpole", "--hidden", "64", "9999999", "--out", "x"],
            "`hidden` must be at most 16,384 units a layer, got 9999999.",
        ),
        (["embed", "x", "--hidden", "9999999"], "`hidden` must be at most 16,384 units a layer"),
        (
            ["control", "cartpole-swingup", "--horizon-s", "1e7", "--out", "x"],
            "`horizon_s` must be at least one control step of 0.04 s and at most 10,000 (400 s), got 1e+07.",
        ),
        (["play", "x", "--video", "x.txt"], "x.txt is not a film; give FILE.gif or FILE.mp4"),
        (["play", "x", "--video", "/no/x.gif"], "there is no folder /no: make it, or give another --video"),
        (["export", "e"], "Missing from planspace export: FILE"),
        (["export", "e", "e.onnx", "--to", "torch"], "invalid choice 'torch'"),
        (["export", "e", "e.pt"], "e.pt has the suffix '.pt', which is not a known format"),
        (["export", "e", "encoder"], "encoder has the suffix '', which is not a known format"),
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
    assert err.strip() == (
        f"planspace: {tmp_path}/nowhere does not exist. `planspace plan` and `planspace demos import` make "
        "datasets."
    )
    code, _, err = call(capsys, "demos", "show", tmp_path / "nowhere", "--debug")
    assert code == 1 and "Traceback" in err


def test_an_out_folder_that_cannot_be_written(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    code, _, err = call(capsys, "run", "--budget", "smoke", "--out", tmp_path / "file" / "run")
    assert code == 1
    assert "cannot write" in err and "Not a directory" in err and len(err.strip().splitlines()) == 1


def test_help_imports_nothing_heavy() -> None:
    heavy = ("onnx", "onnxruntime", "tensorboard", "matplotlib", "plotly", "jax")
    code = "import sys; from planspace.cli import main; main(['measure', '--help']); "
    code += f"print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_doctor_examines_this_machine(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = call(capsys, "doctor", "--json")
    findings = json.loads(out)
    assert code == 0
    assert findings["mujoco.batch"]["ok"] and findings["[test]"]["ok"]
    assert all(f["ok"] or f["advice"] for f in findings.values())  # a line of advice for all that is missing
    code, out, _ = call(capsys, "doctor")
    assert code == 0 and len(out.strip().splitlines()) == len(findings)


def test_doctor_reports_old_versions_and_what_an_extra_of_an_extra_needs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    needs = {
        "planspace": [
            "numpy>=2",
            "torch>=2.10; extra == 'torch'",
            "gymnasium[mujoco]; extra == 'robots'",
            "ompl; extra == 'ompl'",
        ],
        "gymnasium": ["imageio; extra == 'mujoco'", "pygame; extra == 'other'"],
    }
    extras = {"planspace": ["torch", "robots", "ompl"], "gymnasium": ["mujoco", "other"]}
    versions = {"planspace": "1", "numpy": "1.26", "torch": "2.5.1", "gymnasium": "1.4"}

    def version(package: str) -> str:
        if package not in versions:
            raise PackageNotFoundError
        return versions[package]

    def metadata(package: str) -> Message:
        about = Message()
        for extra in extras[package]:
            about["Provides-Extra"] = extra
        return about

    monkeypatch.setattr("importlib.metadata.requires", needs.get)
    monkeypatch.setattr("importlib.metadata.metadata", metadata)
    monkeypatch.setattr("planspace.cli.doctor.version", version)
    monkeypatch.setattr("planspace.cli.doctor.rendering_backend", lambda: "egl")
    findings = {finding.name: finding for finding in examine()}
    assert findings["numpy"].value == "missing: numpy>=2 (found 1.26)"
    assert findings["numpy"].advice == "pip install 'numpy>=2'"
    assert findings["[torch]"].value == "missing: torch>=2.10 (found 2.5.1)"
    assert findings["[robots]"].value == "missing: imageio" and not findings["[robots]"].ok
    assert "[ompl]'" in findings["[ompl]"].advice
    monkeypatch.setattr(sys, "version_info", (3, 13, 0))
    (ompl,) = (finding for finding in examine() if finding.name == "[ompl]")
    assert ompl.advice == "ompl needs Python 3.12 or older on linux, darwin: it has no other wheels"


def test_doctor_explains_an_opengl_backend_that_breaks_mujoco() -> None:
    code = "import sys; from planspace.cli import main; sys.exit(main(['doctor']))"
    environment = {**os.environ, "MUJOCO_GL": "nonsense"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert "MuJoCo cannot be imported (RuntimeError)  -> unset MUJOCO_GL, which is set to" in done.stdout


def test_an_opengl_backend_that_breaks_mujoco_is_said_in_one_line() -> None:
    code = "import sys; from planspace.cli import main; sys.exit(main(['plan', '--list']))"
    environment = {**os.environ, "MUJOCO_GL": "nonsense"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("planspace: MuJoCo cannot be imported: unset MUJOCO_GL, which is set to")
    assert done.stderr.count("\n") == 1


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    import planspace

    assert call(capsys, "--version")[1].strip() == planspace.__version__


def test_repair_says_what_it_found(
    demo_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(demo_folder, tmp_path / "demos")
    assert call(capsys, "repair", folder) == (0, f"No file in {folder} is damaged.\n", "")
    (folder / "shard-00001.safetensors").write_bytes(b"")
    code, out, _ = call(capsys, "repair", folder)
    assert code == 0 and "shard-00001.safetensors was altered or damaged" in out
    assert "Run the command that made them again" in out
    assert call(capsys, "demos", "validate", folder)[0] == 0


@pytest.mark.parametrize(
    "error", [MemoryError(), ValueError("std::bad_alloc"), RuntimeError("RESOURCE_EXHAUSTED: Out of memory")]
)
def test_too_little_memory_is_one_line(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise error

    monkeypatch.setattr("planspace.cli.doctor.examine", full)
    assert main(["doctor"]) == 1
    shown = capsys.readouterr().err
    assert shown.startswith("planspace: not enough memory for this command: try smaller numbers")
    assert len(shown.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["curves", "runs/a", "--out", ""], "--out"),
        (["plan", "cartpole-swingup", "--out="], "--out"),
        (["embed", ""], "an argument"),
        (["plan", "", "--num", "3"], "an argument"),
    ],
)
def test_an_empty_argument_is_refused(
    arguments: list[str],
    what: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert capsys.readouterr().err == f"planspace: {what} is empty. Is a variable of the shell not set?\n"
    assert list(tmp_path.iterdir()) == []


def test_a_value_may_end_with_an_equals_sign(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demos", "validate", "no-such=folder="]) == 2
    assert main(["curves", "--out=a="]) == 2
    assert "is empty" not in capsys.readouterr().err
