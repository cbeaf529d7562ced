import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_demos, import_demos, preview
from planspace.demos.dataset import Demos
from planspace.demos.formats.lerobot import read_lerobot
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError

from .lerobot_folders import FEATURES, FPS, LENGTHS, NAMES, frames, load, table, write_2, write_3

parquet = pytest.importorskip("pyarrow.parquet")


@pytest.mark.parametrize("write", [write_2, write_3])
def test_both_layouts_give_the_same_demonstrations(write: Callable, tmp_path: Path, capsys) -> None:
    write(tmp_path / "set")
    demos = load(tmp_path)
    assert demos.info == StateInfo(tuple(NAMES), ("", ""), (), 2)
    assert np.diff(demos.offsets).tolist() == list(LENGTHS)
    for i, length in enumerate(LENGTHS):
        columns, episode = frames(i, length), demos.episode(i)
        assert np.array_equal(episode.states, columns["observation.state"].astype(float))
        assert np.array_equal(episode.controls, columns["action"].astype(float)[:-1])
        assert np.array_equal(episode.times, np.arange(length) / FPS)  # not the rounded float32
    assert capsys.readouterr().err == (
        "left out: observation.effort (2 numbers), observation.images.top (video), next.reward (1 numbers); "
        "--state NAME=KEY[INDEX] chooses other numbers.\n"
        "the source names the splits train (2), test (1): --split source uses them.\n"
    )


def test_states_are_chosen_by_name_index_or_key(tmp_path: Path) -> None:
    write_3(tmp_path / "set")
    places = {"a": "lift.pos", "b": "0", "c": "observation.effort[1]", "d": "next.reward"}
    demos = load(tmp_path, states=places)
    columns = frames(0, LENGTHS[0])
    state, effort = columns["observation.state"], columns["observation.effort"]
    expected = np.stack([state[:, 1], state[:, 0], effort[:, 1], 0 * state[:, 0]], axis=1)
    assert demos.info.names == tuple(places)
    assert np.array_equal(demos.episode(0).states, expected)


@pytest.mark.parametrize("prefix", ["", "lerobot:"])
def test_a_dataset_is_loaded_without_an_import(prefix: str, tmp_path: Path) -> None:
    write_2(tmp_path / "set")
    assert len(load_demos(f"{prefix}{tmp_path / 'set'}")) == len(LENGTHS)


def test_a_split_selects_episodes(tmp_path: Path) -> None:
    write_3(tmp_path / "set")
    demos = load(tmp_path, filter_key="test")
    assert np.array_equal(demos.states, frames(2, LENGTHS[2])["observation.state"].astype(float))
    with pytest.raises(UsageError, match="unknown split 'val'. Known: test, train"):
        load(tmp_path, filter_key="val")


def test_splits_are_passed_on_as_numbers_of_demonstrations(tmp_path: Path) -> None:
    write_2(tmp_path / "set")
    lines = (tmp_path / "set/meta/episodes.jsonl").read_text().replace('"length": 4', '"length": 1')
    (tmp_path / "set/meta/episodes.jsonl").write_text(lines)  # episode 0 is left out
    imported = read_lerobot([str(tmp_path / "set")], None, ImportOptions())
    assert imported.splits == {"train": [0], "test": [1]}


def test_the_table_shows_every_feature(tmp_path: Path) -> None:
    write_3(tmp_path / "set")
    table, num = preview([str(tmp_path / "set")], None, ImportOptions())
    rows = {line.split("  ")[0]: line for line in table.splitlines()}
    assert num == len(LENGTHS)
    assert set(rows) >= {"timestamp", "episode_index", "pan.pos", "action pan.pos", "observation.images.top"}
    assert "unused" in rows["observation.effort"] and "state" in rows["lift.pos"]


def test_the_states_of_a_problem_are_found_by_name(tmp_path: Path) -> None:
    write_3(tmp_path / "set")
    demos = load(tmp_path, info=StateInfo(("lift.pos", "pan.pos"), ("rad", "rad"), (), 2))
    state = frames(0, LENGTHS[0])["observation.state"].astype(float)
    assert np.array_equal(demos.episode(0).states, state[:, ::-1])


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ({"motors": ["a", "b"]}, ("a", "b")),
        ({"b": 1, "a": 0}, ("a", "b")),
        ([["a", "b"]], ("a", "b")),
        (["motors"], ("observation.state[0]", "observation.state[1]")),
        (["a", "a"], ("observation.state[0]", "observation.state[1]")),
        (None, ("observation.state[0]", "observation.state[1]")),
    ],
)
def test_names_are_read_as_recorders_write_them(names, expected: tuple[str, ...], tmp_path: Path) -> None:
    features = {**FEATURES, "observation.state": {"dtype": "float32", "shape": [2], "names": names}}
    write_3(tmp_path / "set", features=features)
    assert load(tmp_path).info.names == expected


def test_time_stamps_that_differ_from_the_frame_rate_are_kept(tmp_path: Path) -> None:
    write_2(tmp_path / "set")
    columns = {**frames(1, 3), "timestamp": np.array([0, 0.05, 0.2])}
    parquet.write_table(table(columns), tmp_path / "set/data/chunk-000/episode_000001.parquet")
    demos = load(tmp_path, as_recorded=True)
    assert demos.episode(1).times.tolist() == [0, 0.05, 0.2]


def test_episodes_of_one_frame_are_left_out(tmp_path: Path, capsys) -> None:
    write_2(tmp_path / "set")
    lines = (tmp_path / "set/meta/episodes.jsonl").read_text().replace('"length": 3', '"length": 1')
    (tmp_path / "set/meta/episodes.jsonl").write_text(lines)
    assert len(load(tmp_path)) == 2
    assert "1 of 3 episodes have fewer than two frames: left out." in capsys.readouterr().err


# --- export -----------------------------------------------------------------------------------------


def test_export_and_import_are_exact(demos: Demos, tmp_path: Path) -> None:
    costs = np.where(np.arange(len(demos)) == 1, np.nan, demos.costs)
    demos = replace(demos, states=demos.states * (1 + 2**-50), costs=costs)  # float32 would round these
    assert export_demos(demos, f"lerobot:{tmp_path / 'set'}") == tmp_path / "set"
    back = load(tmp_path)
    assert back.hash == demos.hash and back.info == demos.info
    for name in ("states", "controls", "times", "goals", "success", "indices", "seeds", "costs"):
        np.testing.assert_array_equal(getattr(back, name), getattr(demos, name))


def test_the_export_has_the_published_layout(demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"lerobot:{tmp_path / 'set'}")
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert (info["codebase_version"], info["total_episodes"]) == ("v3.0", len(demos))
    assert info["features"]["observation.state"] == {
        "dtype": "float64",
        "shape": [4],
        "names": list(demos.info.names),
    }
    data = parquet.read_table(tmp_path / "set/data/chunk-000/file-000.parquet")
    for key, feature in info["features"].items():
        kind = str(data.schema.field(key).type)
        number = {"float64": "double", "float32": "float", "int64": "int64"}[feature["dtype"]]
        size = feature["shape"][0]
        assert kind == (number if size == 1 else f"fixed_size_list<element: {number}>[{size}]")
    assert data["index"].to_pylist() == list(range(len(demos.states)))
    rows = parquet.read_table(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [row["dataset_to_index"] for row in rows] == demos.offsets[1:].tolist()
    assert rows[0]["stats/observation.state/max"] == demos.episode(0).states.max(axis=0).tolist()
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text())
    assert stats["observation.state"]["count"] == [len(demos.states)]


def test_data_is_divided_into_files(demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planspace.demos.formats.lerobot_export.FILE_BYTES", 1)
    monkeypatch.setattr("planspace.demos.formats.lerobot_export.CHUNK_FILES", 2)
    export_demos(demos, f"lerobot:{tmp_path / 'set'}")
    assert (tmp_path / "set/data/chunk-001/file-000.parquet").exists()
    assert load(tmp_path).hash == demos.hash


def test_uneven_steps_are_reported_and_kept(demos: Demos, tmp_path: Path, capsys) -> None:
    times = demos.times.copy()
    times[1] *= 1.5
    demos = replace(demos, times=times)
    export_demos(demos, f"lerobot:{tmp_path / 'set'}")
    assert "the time steps are uneven; fps is" in capsys.readouterr().err
    assert load(tmp_path, as_recorded=True).hash == demos.hash


def test_states_without_controls_and_states_of_one_number(demos: Demos, tmp_path: Path) -> None:
    demos = replace(
        demos,
        info=StateInfo(("x",), ("m",), (), 0),
        states=demos.states[:, :1],
        controls=demos.controls[:, :0],
        goals=demos.goals[:, :1],
    )
    export_demos(demos, f"lerobot:{tmp_path / 'set'}")
    assert load(tmp_path).hash == demos.hash


def test_an_existing_folder_is_not_replaced(demos: Demos, tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "notes.txt").write_text("mine")
    with pytest.raises(PlanspaceError, match="set already exists; export to a new folder"):
        export_demos(demos, f"lerobot:{tmp_path / 'set'}")
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_names_and_times_of_an_export_need_no_options(demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"lerobot:{tmp_path / 'set'}")
    with pytest.raises(UsageError, match="which planspace exported with names; leave it out"):
        load(tmp_path, states={"x": "slider"})


def test_an_export_that_another_program_changed_is_refused(demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"lerobot:{tmp_path / 'set'}")
    rows = parquet.read_table(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet")
    parquet.write_table(rows.slice(1), tmp_path / "set/meta/episodes/chunk-000/file-000.parquet")
    with pytest.raises(
        PlanspaceError, match=r"planspace\.json describes \d+ demonstrations, but the dataset"
    ):
        load(tmp_path)
    (tmp_path / "set/meta/planspace.json").unlink()
    assert len(load(tmp_path)) == len(demos) - 1


# --- refusals ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("known", "options", "message"),
    [
        (
            {"codebase_version": "v1.6"},
            {},
            r"info\.json: 'codebase_version' is 'v1\.6'; planspace reads v2\.0",
        ),
        ({"codebase_version": None}, {}, "'codebase_version' is None"),
        ({"fps": 0}, {}, "'fps' must be a positive number of frames per second, got 0"),
        ({"features": {}}, {}, "'features' must be an object with the features"),
        (
            {"features": {"action": 3}},
            {},
            "'features/action' must be an object with 'dtype' and 'shape', got 3",
        ),
        ({"splits": {"train": "all"}}, {}, "'splits/train' must be a range such as '0:50', got 'all'"),
        (
            {"features": {k: v for k, v in FEATURES.items() if not k.startswith("observation")}},
            {},
            r"has no feature 'observation.state' of numbers; choose .* --state NAME=KEY\[INDEX\]",
        ),
        ({}, {"states": {"x": "elbow.pos"}}, "have no key 'elbow.pos'; the keys are: action, .*pan.pos"),
        ({}, {"states": {"x": "action[2]"}}, "has 2 numbers there: give an index from 0 to 1"),
        ({}, {"dt": 0.1}, "--dt cannot be used with .* which has its own times; leave it out"),
    ],
)
def test_what_does_not_fit_is_refused(known: dict, options: dict, message: str, tmp_path: Path) -> None:
    write_3(tmp_path / "set", **known)
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, **options)
    assert not (tmp_path / "out").exists()


def test_two_datasets_are_refused(tmp_path: Path) -> None:
    write_3(tmp_path / "a")
    write_3(tmp_path / "b")
    with pytest.raises(UsageError, match="import one LeRobot dataset at a time"):
        import_demos([str(tmp_path / "a"), str(tmp_path / "b")], tmp_path / "out", None, ImportOptions())


def test_a_missing_pyarrow_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_3(tmp_path / "set")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(PlanspaceError, match=r"need the package pyarrow: pip install .*\[data\]'"):
        load(tmp_path)


def test_pyarrow_is_imported_only_for_parquet() -> None:
    code = "import sys, planspace.demos.convert; sys.exit('pyarrow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
