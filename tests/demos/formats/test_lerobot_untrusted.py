"""LeRobot datasets that lead to other files, or that declare or contain more than they may."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.load import load_demos
from planspace.errors import PlanspaceError

from .lerobot_folders import LENGTHS, frames, load, table, write_2, write_3

parquet = pytest.importorskip("pyarrow.parquet")

DATA = "data/chunk-000/file-000.parquet"


@pytest.mark.parametrize(
    ("template", "message"),
    [
        ("../secret/{episode_index:06d}.parquet", "is not a path within the dataset folder"),
        ("/etc/{episode_index:06d}.parquet", "is not a path within the dataset folder"),
        ("data\\{episode_index:06d}.parquet", "is not a path within the dataset folder"),
        ("data/{episode_index.__class__}.parquet", "'data_path' must be a template with {episode_chunk:03d}"),
        ("data/{episode_index:999999999d}", "'data_path' must be a template"),
        ("data/{episode_index!r}", "'data_path' must be a template"),
        ("data/{video_key}", "'data_path' must be a template"),
        ("data/{", "'data_path' must be a template"),
        (7, "'data_path' must be a template of paths, got 7"),
    ],
)
def test_a_template_does_not_lead_elsewhere(template, message: str, tmp_path: Path) -> None:
    write_2(tmp_path / "set", data_path=template)
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path)


@pytest.mark.parametrize("name", ["meta/info.json", "meta/episodes/chunk-000/file-000.parquet", DATA, "data"])
def test_links_out_of_the_folder_are_refused(name: str, tmp_path: Path) -> None:
    write_3(tmp_path / "set")
    shutil.move(tmp_path / "set" / name, tmp_path / "elsewhere")
    (tmp_path / "set" / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(PlanspaceError, match="is a link out of its folder, to .*elsewhere.*cp -rL"):
        load(tmp_path)


def column(name: str, values) -> Callable[[Path], None]:
    """A change of a column in the first file of data."""

    def change(file: Path) -> None:
        whole = parquet.read_table(file)
        index = whole.schema.get_field_index(name)
        if values is None:
            parquet.write_table(whole.remove_column(index), file)
        else:
            parquet.write_table(whole.set_column(index, name, [values]), file)

    return change


def other_file(file: Path) -> None:
    """A file of which the first column is in another file."""
    collected: list = []
    whole = parquet.read_table(file)
    parquet.write_table(whole, file, metadata_collector=collected)
    collected[0].set_file_path("../secret.parquet")
    collected[0].write_metadata_file(file)


def many_rows(file: Path) -> None:
    """Ten million equal rows in a few kilobytes."""
    columns = table({"episode_index": np.zeros(10_000_000, int)})
    parquet.write_table(columns, file, compression="zstd", max_rows_per_page=10_000_000)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: file.unlink(), "No such file"),
        (lambda file: file.write_bytes(b""), "not a readable Parquet file|cannot read"),
        (lambda file: file.write_bytes(b"PAR1" + bytes(100) + b"PAR1"), "cannot read"),
        (other_file, "keeps the column 'observation.state.* in another file, '../secret.parquet'"),
        (many_rows, "declares 10000000 rows, more than its bytes can contain"),
        (column("action", None), "has no column 'action'; it has 'observation.state'"),
        (column("action", ["x"] * 7), "column 'action' must contain numbers or lists of numbers, got string"),
        (column("action", [[1.0, 2.0]] * 6 + [[3.0]]), "lists of different lengths|1 in row 6"),
        (column("action", [[1.0, 2.0]] * 6 + [None]), "column 'action' is empty in row 6"),
        (column("action", [[1.0, 2.0]] * 6 + [[1.0, None]]), "column 'action' is empty in row 6"),
        (column("observation.state", [[1.0]] * 7), "has 1 numbers, but `meta` says 2"),
        (column("observation.state", [[1.0, np.nan]] * 7), "demonstration 0, row 0: lift.pos is not finite"),
        (column("episode_index", [0] * 7), "has 7 frames of episode 0, but `meta` says 4"),
        (column("episode_index", [0] * 4 + [9] * 3), "has no episode 1, which `meta` says is in it"),
        (
            column("timestamp", [0, 0.1, 0.1, 0.2, 0, 1, 2]),
            "episode 0, frame 2: the time .* does not come after",
        ),
    ],
)
def test_hostile_or_damaged_files_are_refused(change: Callable, message: str, tmp_path: Path) -> None:
    write_3(tmp_path / "set")
    change(tmp_path / "set" / DATA)
    with pytest.raises(PlanspaceError, match=message) as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_row_group_that_does_not_fit_in_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_3(tmp_path / "set")
    monkeypatch.setattr("planspace.demos.formats.parquet_file.MAX_GROUP_BYTES", 100)
    with pytest.raises(PlanspaceError, match=r"row group 0 has \d+ bytes, which do not fit in memory"):
        load(tmp_path)


def test_batches_of_any_size_give_the_same_demonstrations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_3(tmp_path / "set")
    expected = load(tmp_path).hash
    for size in (1, 2, 3, 5):
        monkeypatch.setattr("planspace.demos.formats.parquet_file.BATCH_ROWS", size)
        assert load(tmp_path).hash == expected


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", r"episodes\.jsonl, line 2 is not valid JSON"),
        ("3", "line 2 must have the numbers 'episode_index' and 'length', got 3"),
        ('{"episode_index": 1, "length": -1}', "line 2 must have the numbers"),
        ('{"episode_index": 0, "length": 3}', "has two lines for episode 0"),
    ],
)
def test_damaged_lists_of_episodes_are_refused(line: str, message: str, tmp_path: Path) -> None:
    write_2(tmp_path / "set")
    file = tmp_path / "set/meta/episodes.jsonl"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([lines[0], line, lines[2]]))
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path)


def test_a_damaged_description_by_planspace_is_refused(tmp_path: Path) -> None:
    write_3(tmp_path / "set")
    file = tmp_path / "set/meta/planspace.json"
    for text, message in (
        ("{}", "was written by a newer planspace"),
        ('{"schema": 1}', "the description of the states is damaged"),
        (json.dumps({"schema": 1, "info": {"names": 3}}), "the description of the states is damaged"),
    ):
        file.write_text(text)
        with pytest.raises(PlanspaceError, match=message):
            load(tmp_path)


def test_a_subprocess_reads_the_same_demonstrations(tmp_path: Path, capsys) -> None:
    write_3(tmp_path / "set")
    read = {}
    for untrusted in (False, True):
        read[untrusted] = load(tmp_path, untrusted=untrusted).hash, capsys.readouterr().err
    assert read[True] == read[False]
    assert len(load_demos(tmp_path / "out")) == len(LENGTHS)


def test_a_subprocess_says_what_is_wrong(tmp_path: Path) -> None:
    write_3(tmp_path / "set")
    columns = {**frames(2, LENGTHS[2]), "action": np.full((LENGTHS[2], 2), np.inf)}
    parquet.write_table(table(columns), tmp_path / "set/data/chunk-000/file-001.parquet")
    with pytest.raises(PlanspaceError, match="demonstration 2, row 0: control1 is not finite"):
        load(tmp_path, untrusted=True)
