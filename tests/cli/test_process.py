"""Interrupts, and what untrusted files can print."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from planspace.storage.json_files import read_sealed, write_sealed

from .calls import call


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_ctrl_c_stops_cleanly_and_the_same_command_continues(tmp_path: Path) -> None:
    heed = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # ignored in the background
    )
    start = f"{heed}; from planspace.cli import main; raise SystemExit(main())"
    command = [sys.executable, "-c", start, "train", "cartpole-swingup", "--seeds", "1"]
    command += ["--steps", "160000", "--out", str(tmp_path / "run")]
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
    assert 10 <= done < 40
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    rows = [json.loads(row) for row in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert [row["iteration"] for row in rows] == list(range(1, 41))  # none lost, none twice


@pytest.mark.skipif(os.name == "nt", reason="POSIX pipes")
def test_a_reader_that_stops_early_is_no_failure(demo_folder: Path) -> None:
    read, write = os.pipe()
    os.close(read)  # as `head` does when it has its lines
    command = [sys.executable, "-m", "planspace", "demos", "show", str(demo_folder)]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


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
