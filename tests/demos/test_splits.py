"""Splits that a source or a file names."""

import json
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.splits import complete_splits, place_splits
from planspace.demos.stored import StoredDemos
from planspace.errors import PlanspaceError, UsageError

ROWS = [
    f"{e},{i},{e + i},{'train' if e < 4 else 'val' if e < 6 else 'test'}" for e in range(8) for i in range(3)
]
TABLE = "\n".join(["episode,time,x,subset", *ROWS])


def load(tmp_path: Path, **options):
    (tmp_path / "a.csv").write_text(TABLE)
    import_demos([str(tmp_path / "a.csv")], tmp_path / "out", None, ImportOptions(**options))
    return load_demos(tmp_path / "out")


def test_a_column_names_the_split_of_each_demonstration(tmp_path: Path) -> None:
    demos = load(tmp_path, split="subset")
    wanted = {"train": [0, 1, 2, 3], "validation": [4, 5], "test": [6, 7]}
    for seed in (0, 1):
        assert {name: part.tolist() for name, part in demos.split(seed).items()} == wanted
        assert StoredDemos(tmp_path / "out").split(seed)["test"].tolist() == [6, 7]
    assert demos.info.names == ("x",)
    assert demos.select(["x"]).split(0)["test"].tolist() == [6, 7]
    demos.save(tmp_path / "copy")
    assert load_demos(tmp_path / "copy").split(0)["test"].tolist() == [6, 7]


def test_a_file_names_the_demonstrations_of_each_split(tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text(json.dumps({"train": [7, 6, 5, 4], "test": [0]}))
    found = load(tmp_path, split=str(tmp_path / "s.json"), drop=["subset"]).split(0)
    assert found["test"].tolist() == [0] and len(found["validation"]) == 1
    assert sorted([*found["train"], *found["validation"]]) == [4, 5, 6, 7]


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        ({"train": [0, 1], "test": [9]}, "the test demonstrations include number 9, which was not imported"),
        ({"train": [0, 1], "test": [1]}, "a demonstration is in two splits"),
        ({"train": [0, 1]}, "needs training demonstrations and others; the splits are train"),
        ({"train": "all"}, "must be an object with lists of numbers"),
    ],
)
def test_splits_that_do_not_fit_are_refused(splits: dict, message: str, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text(json.dumps(splits))
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, split=str(tmp_path / "s.json"), drop=["subset"])
    assert not (tmp_path / "out").exists()


def test_unknown_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--split: unknown column 'subse'. Did you mean 'subset'"):
        load(tmp_path, split="subse", drop=["subset"])
    with pytest.raises(UsageError, match="the source names no splits"):
        load(tmp_path, split="source", drop=["subset"])


def test_places_follow_the_demonstrations_that_are_left() -> None:
    # demonstrations 1 and 4 were left out, 2 was cut in two
    indices = np.array([0, 2, 2, 3, 5])
    with pytest.raises(UsageError, match="include number 1, which was not imported"):
        place_splits({"train": [0, 1, 2], "valid": [3]}, indices)
    placed = place_splits({"train": [0, 2], "valid": [3], "20_percent": [0]}, indices)
    assert placed == {"train": [0, 1, 2], "validation": [3]}
    whole = complete_splits(placed, 0)
    assert whole["validation"].tolist() == [3] and len(whole["test"]) == 1 and len(whole["train"]) == 2
