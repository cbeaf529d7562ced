"""Measuring and exporting embeddings."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.storage.json_files import read_sealed, write_sealed

from .calls import call


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
    on_plans = np.arange(4) < 2
    np.savez(truth, states=np.eye(4), time=np.arange(4.0), goals=np.zeros((4, 4)), on_plans=on_plans)
    command = ["measure", embedding_folder, demo_folder, "--plot", pictures, "--truth", truth]
    code, out, _ = call(capsys, *command)
    for said in ("train  ", "validation  ", "test  ", "95 % interval", "raw state", "true_time_correlation"):
        assert said in out
    for said in (
        "n/a: path_error, path_error_std, duration_error (one demonstration",
        "sampling: one state every",
    ):
        assert said in out
    last = out[out.index("\nverdict\n") :]
    assert "\n  weak           Only 1 demonstration of the test split" in last and "\n  try  " in last
    for said in ("true times, on plans", "rank_correlation", "by tenths", "true (raw state)"):
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
    found = json.loads(out)
    assert code == 0 and found["figures"] == str(tmp_path / "p")
    assert list(found["verdict"]) == ["good", "weak", "not_supported", "try"]
    assert "<title>3 demonstrations of" in (tmp_path / "p" / "paths.html").read_text()
    assert not (tmp_path / "p" / "training.png").exists()  # there is no log to draw
    (tmp_path / "file").touch()
    code, out, err = call(capsys, *command[:3], "--plot", tmp_path / "file")
    assert (
        (code, out) == (1, "")
        and "file is a file, and a folder is needed" in err
        and len(err.splitlines()) == 1
    )


@pytest.mark.parametrize(
    ("row", "seeds", "file"),
    [
        ({"step": 1, "path_error": "small", "bound": 1}, [0, 1], "log.jsonl"),
        ({"step": 1, "path_error": [1, 2], "bound": [[1], [2]]}, [0, 1], "log.jsonl"),
        ({"step": 1, "path_error": [1, 2], "bound": [1, 2]}, [0], "log.jsonl"),
        ({"step": 1, "path_error": [1, 2], "bound": [1, 2]}, [7, 8], "embedding.json"),
        ({"step": 1, "path_error": [1, 2], "bound": [1, 2]}, 3, "embedding.json"),
    ],
)
def test_an_invalid_log_or_description_is_reported_before_anything_is_drawn(
    row: dict,
    seeds: Any,
    file: str,
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
    assert str(folder / file) in line and "planspace repair" in line


def test_an_embedding_goes_out_as_onnx(
    capsys: pytest.CaptureFixture[str], embedding_folder: Path, tmp_path: Path
) -> None:
    onnx = pytest.importorskip("onnx")
    file = tmp_path / "e.onnx"
    assert call(capsys, "export", embedding_folder, file) == (0, f"{file}\n", "")
    assert [output.name for output in onnx.load(file).graph.output] == ["mu", "sigma"]
    code, out, err = call(capsys, "export", embedding_folder, file)
    assert (code, out) == (1, "")
    assert err == f"planspace: {file} exists already; choose another file, or remove it first.\n"
    assert call(capsys, "export", embedding_folder, tmp_path / "e.bin", "--to", "onnx")[0] == 0
