from pathlib import Path

import numpy as np
import pytest

from planspace.errors import PlanspaceError

from .lerobot_folders import frames, load, table, write_2

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

COLUMNS = {
    "t": 0.1 * np.arange(6),
    "episode": np.repeat([0, 1], 3),
    "x": np.arange(6.0),
    "q": np.arange(12.0).reshape(6, 2),
    "action": -np.arange(6.0),
}


@pytest.mark.parametrize("untrusted", [False, True])
def test_columns_and_lists_are_read(untrusted: bool, tmp_path: Path, capsys) -> None:
    whole = table(COLUMNS, fixed=untrusted).append_column("who", [["me"] * 6])
    parquet.write_table(whole, tmp_path / "set.parquet", row_group_size=4)
    demos = load(tmp_path, "set.parquet", untrusted=untrusted)
    assert demos.info.names == ("x", "q[0]", "q[1]")
    assert np.array_equal(demos.states, np.column_stack([COLUMNS["x"], COLUMNS["q"]]))
    assert np.array_equal(demos.controls[:, 0], [0, -1, -3, -4])
    assert demos.offsets.tolist() == [0, 3, 6]
    assert "left out, because they are not numbers: who." in capsys.readouterr().err


def test_columns_are_chosen_by_name(tmp_path: Path) -> None:
    parquet.write_table(table(COLUMNS), tmp_path / "set.parquet")
    demos = load(tmp_path, "set.parquet", states={"a": "q[1]"}, time="t", episode="episode")
    assert np.array_equal(demos.states[:, 0], COLUMNS["q"][:, 1])


def test_a_file_of_lerobot_is_a_table_too(tmp_path: Path) -> None:
    write_2(tmp_path / "folder")
    (tmp_path / "folder/data/chunk-000/episode_000000.parquet").rename(tmp_path / "set.parquet")
    demos = load(tmp_path, "set.parquet", drop=("observation.effort[0]", "observation.effort[1]"))
    assert demos.info.names == ("observation.state[0]", "observation.state[1]")
    assert np.array_equal(demos.states, frames(0, 4)["observation.state"].astype(float))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            {"x": COLUMNS["x"]},
            "set.parquet has no column with the name of a time; its columns are x. Give --time",
        ),
        ({"who": np.array(["me"])}, "set.parquet has no column of numbers; it has who"),
        ({"t": np.zeros(0)}, "set.parquet has no rows"),
        (
            {"t": COLUMNS["t"], "x": np.where(COLUMNS["x"] == 2, np.inf, COLUMNS["x"])},
            "row 2: column 'x' must be a",
        ),
    ],
)
def test_what_does_not_fit_is_refused(columns: dict, message: str, tmp_path: Path) -> None:
    parquet.write_table(table(columns), tmp_path / "set.parquet")
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, "set.parquet")
