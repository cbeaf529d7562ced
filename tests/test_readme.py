"""The README's Python blocks run, and its commands and folders exist."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

README = Path(__file__).parents[1] / "README.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README.read_text(), flags=re.DOTALL)


def test_python_blocks_run(embedding_folder: Path) -> None:
    code = blocks("python")
    assert code
    for block in code:
        assert "runs/cartpole-swingup-small/embedding" in block
        names: dict = {}
        exec(block.replace("runs/cartpole-swingup-small/embedding", str(embedding_folder)), names)
        assert names["env"].reset()[0].shape == (7,)
        assert names["obs"].shape == (64, 7)
        assert np.isfinite(names["obs"]).all()


def test_named_commands_exist(capsys: pytest.CaptureFixture[str]) -> None:
    from planspace.cli import main

    verbs = set(
        re.findall(
            r"planspace (run|plan|demos|embed|measure|export|train|report|doctor)\b", README.read_text()
        )
    )
    assert {"run", "plan", "embed", "train"} <= verbs
    for verb in verbs:
        assert main([verb, "--help"]) == 0
    capsys.readouterr()


def test_folder_map_is_complete() -> None:
    root = README.parent
    named = re.findall(r"^    (src/planspace/\S+|\w+/) ", README.read_text(), re.MULTILINE)
    assert [n for n in named if not (root / n).exists()] == []
    package = root / "src" / "planspace"
    parts = {f"src/planspace/{p.parent.name}/" for p in package.glob("*/__init__.py")}
    parts |= {f"src/planspace/{p.name}" for p in package.glob("*.py") if not p.name.startswith("__")}
    assert parts <= set(named)


def test_the_number_of_ten_seeds() -> None:
    with open(README.parent / "results" / "run" / "first_number.csv") as file:
        rows = list(csv.DictReader(file))
    assert sorted(int(row["seed"]) for row in rows) == [*range(10)]
    assert all(float(row["low"]) > 0 and row["starts"] == "50" for row in rows)
    z, raw, difference = (sorted(float(row[key]) for row in rows) for key in ("z", "raw", "difference"))
    text = README.read_text().replace("\n", " ")
    assert f"distance in z succeeded from {z[0]:.0f} to {z[-1]:.0f} of 50 starts" in text
    assert f"by raw distance from {raw[0]:.0f} to {raw[-1]:.0f}; the difference was" in text
    assert f"was {100 * difference[0]:+.0f} to {100 * difference[-1]:+.0f} percentage points" in text
