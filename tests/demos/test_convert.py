import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_demos, import_demos, import_npz
from planspace.demos.dataset import Demos
from planspace.demos.describe import describe, validate
from planspace.demos.folder import DemoFolder, remove_damaged_shards
from planspace.demos.formats.csv import read_csv
from planspace.demos.formats.registry import FORMATS
from planspace.demos.load import load_demos
from planspace.demos.recording import Imported, ImportOptions, assignments, recorded
from planspace.demos.state_info import StateInfo
from planspace.demos.stored import StoredDemos
from planspace.demos.tables import import_tables
from planspace.demos.triplets import random_triplets
from planspace.errors import PlanspaceError, UsageError
from tests.demos.archives import archive

CSV = "time,x\n0,1\n0.1,2\n0.2,3\n"


@pytest.mark.parametrize(
    ("files", "sources", "message"),
    [
        (
            [],
            [],
            "give a source to import: FILE.npz, FILE.csv, minari:ID, FILE.hdf5, lerobot:DIR, FILE.parquet,",
        ),
        ([], ["demos"], "demos is not a source of demonstrations; expected FILE.npz"),
        (["a.txt"], ["a.txt"], "a.txt is not a source of demonstrations"),
        (["in/a.txt"], ["in"], "in is not a source of demonstrations"),
        (
            ["in/a.csv", "in/b.json"],
            ["in"],
            "in contains FILE.csv and FILE.json; import one format at a time",
        ),
        (["in/manifest.json"], ["in"], "is already a planspace dataset"),
    ],
)
def test_unknown_or_mixed_sources_are_refused(
    files: list[str], sources: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for file in map(Path, files):
        file.parent.mkdir(exist_ok=True)
        file.touch()
    with pytest.raises(UsageError, match=message):
        import_demos(sources, tmp_path / "out", None, ImportOptions())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        ("a.npz", {"filter_key": "x"}, "--filter-key cannot be used with a.npz"),
        ("a.out", {"controls": {"x": "y"}}, "--control cannot be used with a.out"),
        ("minari:a-v0", {"controls": {"x": "y"}}, "--control cannot be used with minari:a-v0"),
    ],
)
def test_options_that_a_format_cannot_use_are_refused(
    source: str, options: dict, message: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=message):
        import_demos([source], tmp_path / "out", None, ImportOptions(**options))


def test_error_names_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"cannot read .*none\.csv: No such file"):
        import_demos([str(tmp_path / "none.csv")], tmp_path / "out", None, ImportOptions())


def test_repeating_an_import_changes_nothing_and_another_source_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(CSV)
    out = tmp_path / "out"
    import_demos([str(tmp_path / "a.csv")], out, None, ImportOptions())
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    import_demos([str(tmp_path / "a.csv")], out, None, ImportOptions())
    assert before == {p.name: p.read_bytes() for p in out.iterdir()}
    with pytest.raises(PlanspaceError, match="made with other settings: content has changed"):
        import_demos([str(tmp_path / "a.csv")], out, None, ImportOptions(states={"y": "x"}))
    assert describe(out)["made_by"] == {"imported": "a.csv"}


def test_an_invalid_demonstration_late_in_a_source_leaves_no_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planspace.demos.folder.SHARD_EPISODES", 2)
    arrays = archive(6)
    arrays["states"][-1, 0] = np.inf  # in the third shard
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(PlanspaceError, match="bad.npz: demonstration 5, row 19: state0 is not finite"):
        import_npz(tmp_path / "bad.npz", tmp_path / "deep" / "out", None)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.npz"]
    (tmp_path / "out").mkdir()
    with pytest.raises(PlanspaceError, match="not finite"):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)
    assert list((tmp_path / "out").iterdir()) == []


def test_files_of_a_killed_import_are_removed(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **archive(3))
    import_npz(tmp_path / "a.npz", tmp_path / "alone", None)
    left = tmp_path / "out" / ".writing-import" / "recorded"
    left.mkdir(parents=True)
    (left / "manifest.json").write_text("incomplete")
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    assert load_demos(tmp_path / "out").hash == load_demos(tmp_path / "alone").hash
    names = [sorted(path.name for path in (tmp_path / name).iterdir()) for name in ("out", "alone")]
    assert names[0] == names[1] == ["manifest.json", "shard-00000.safetensors"]


@pytest.mark.parametrize("link", [".writing-import", ".writing-import/recorded"])
def test_the_target_of_a_link_is_not_removed(link: str, tmp_path: Path) -> None:
    kept = tmp_path / "theirs" / "recorded" / "thesis.txt"
    kept.parent.mkdir(parents=True)
    kept.write_text("years of work")
    place = tmp_path / "out" / link
    place.parent.mkdir(parents=True)
    place.symlink_to(tmp_path / "theirs")
    np.savez(tmp_path / "a.npz", **archive(3))
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    assert len(load_demos(tmp_path / "out")) == 3
    assert kept.read_text() == "years of work"
    assert [path.name for path in (tmp_path / "theirs").iterdir()] == ["recorded"]


def test_repeating_an_import_restores_a_damaged_shard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planspace.demos.folder.SHARD_EPISODES", 2)
    numbers = [0, 3, 5, 6, 9, 12]  # as in a dataset where some plans failed
    info, step = StateInfo(("x",), ("",), (), 1), np.arange(4.0)
    arrays = step[:, None], np.ones((3, 1)), step
    episodes = [recorded(*arrays, index=number) for number in numbers]
    read = replace(FORMATS["npz"], read=lambda *_: Imported(info, episodes))
    monkeypatch.setitem(FORMATS, "npz", read)
    (tmp_path / "a.npz").touch()
    out = tmp_path / "out"
    import_npz(tmp_path / "a.npz", out, None)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    (out / "shard-00001.safetensors").write_bytes(b"")
    assert remove_damaged_shards(out)
    import_npz(tmp_path / "a.npz", out, None)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_source_that_changes_during_the_import_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(CSV)
    imported = import_tables(read_csv([str(file)], None, ImportOptions()), None, ImportOptions())
    file.write_text("")
    with pytest.raises(PlanspaceError, match="changed while it was being read"):
        list(imported.episodes)


def test_times_that_would_give_too_many_steps_are_refused(tmp_path: Path) -> None:
    rows = [f"{t},0" for t in ("0", "1e-6", "2e-6", "3e-6", "1e9")]
    (tmp_path / "a.csv").write_text("\n".join(["time,x", *rows]))
    with pytest.raises(
        PlanspaceError, match=r"demonstration 0 lasts 1e\+09 s, which is 1e\+15 steps of 1e-06 s"
    ):
        import_demos([str(tmp_path / "a.csv")], tmp_path / "out", None, ImportOptions())
    assert not (tmp_path / "out").exists()


def test_an_interrupted_import_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planspace.demos.folder.SHARD_EPISODES", 2)
    np.savez(tmp_path / "a.npz", **archive(5))
    import_npz(tmp_path / "a.npz", tmp_path / "alone", None)
    append, done = DemoFolder.append, []

    def stop_at_the_second(self: DemoFolder, episodes: list, next_index: int) -> None:
        if self.path == tmp_path / "out":
            done.append(next_index)
            if len(done) == 2:
                raise KeyboardInterrupt
        append(self, episodes, next_index)

    with monkeypatch.context() as patch:
        patch.setattr(DemoFolder, "append", stop_at_the_second)
        with pytest.raises(KeyboardInterrupt):
            import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    assert len(load_demos(tmp_path / "out")) == 2
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    assert load_demos(tmp_path / "out").hash == load_demos(tmp_path / "alone").hash


@pytest.mark.nightly
def test_memory_does_not_grow_with_the_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planspace.demos.folder.SHARD_EPISODES", 100)

    def peak(action: Callable[[], object]) -> int:
        tracemalloc.start()
        try:
            action()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    def draw(folder: Path) -> None:
        stored = StoredDemos(folder)
        rows = random_triplets(stored, np.arange(len(stored)), 1000, np.random.default_rng(0), 0.5)
        assert stored.states_at(rows).shape == (1000, 3, 3)

    peaks = []
    for num in (200, 200, 4000):  # the first run imports and caches everything
        source, folder = tmp_path / f"{len(peaks)}.npz", tmp_path / f"{len(peaks)}"
        np.savez(source, **archive(num))
        actions = (
            lambda source=source, folder=folder: import_npz(source, folder, None),
            lambda folder=folder: validate(folder, replay_controls=False),
            lambda folder=folder: describe(folder),
            lambda folder=folder: draw(folder),
        )
        peaks.append([peak(action) for action in actions])
    whole = peak(lambda: load_demos(tmp_path / "2"))
    for small, large in zip(*peaks[1:], strict=True):
        # one shard and a few numbers per demonstration; the whole dataset has 3 MB
        assert large < 1.2 * small + 4000 * 64 < 0.5 * whole


def test_unknown_export_formats_are_refused(demos: Demos, tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=r"cannot export to .*demos\.txt; give FILE\.npz or FILE\.csv or minari:ID"
    ):
        export_demos(demos, str(tmp_path / "demos.txt"))
    with pytest.raises(PlanspaceError, match="cannot write"):
        export_demos(demos, str(tmp_path / "nowhere" / "demos.csv"))
    assert list(tmp_path.iterdir()) == []


def test_parse_assignments() -> None:
    assert assignments("--state", ["x=a=b", "y = c"]) == {"x": "a=b", "y": "c"}
    for texts, message in ((["x"], "needs NAME=COLUMN, got 'x'"), (["x=1", "x=2"], "names 'x' twice")):
        with pytest.raises(UsageError, match=f"--state {message}"):
            assignments("--state", texts)
    with pytest.raises(UsageError, match="--dt must be a positive number"):
        ImportOptions(dt=float("nan"))


def test_running_out_of_memory_is_a_short_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("planspace.demos.prepare.check_episode", fail)
    (tmp_path / "a.csv").write_text(CSV)
    with pytest.raises(PlanspaceError, match=r"not enough memory to read .*a\.csv"):
        import_demos([str(tmp_path / "a.csv")], tmp_path / "out", None, ImportOptions())
    assert not (tmp_path / "out").exists()


def test_overflow_is_refused_without_a_warning(tmp_path: Path) -> None:
    info = StateInfo(("x",), ("rad",), (0,), 1)
    (tmp_path / "a.csv").write_text("time,x\n-1.7e308,-1e308\n0,1e308\n1.7e308,-1e308\n")
    with pytest.raises(PlanspaceError, match="row 2: the time is not finite"):
        import_demos([str(tmp_path / "a.csv")], tmp_path / "out", info, ImportOptions())


@pytest.mark.parametrize("target", ["minari:mine-v0", "lerobot:{}/set", "{}/set.hdf5"])
def test_exports_are_imported_unchanged(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """Names that suggest angles, full turns, wrapped angles, uneven steps and long gaps stay as they are."""
    for module in ("minari", "pyarrow", "h5py"):
        pytest.importorskip(module)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    info = StateInfo(
        ("yaw", "heading_deg", "frame_index", "qw", "qx", "qy", "qz"), ("", "deg", *[""] * 5), (0,), 1
    )
    turns = np.random.default_rng(0).uniform(-10, 10, (3, 20, 7))
    turns[..., 3:] /= np.linalg.norm(turns[..., 3:], axis=-1, keepdims=True)
    times = np.cumsum([0, *[0.1] * 10, 5.0, *[0.03] * 8])
    episodes = [recorded(states, states[:-1, :1], times, i) for i, states in enumerate(turns)]
    demos = Demos.from_episodes(info, episodes)
    source = target.format(tmp_path)
    export_demos(demos, source)
    capsys.readouterr()
    import_demos([source], tmp_path / "out", None, ImportOptions())
    assert load_demos(tmp_path / "out").hash == demos.hash
    assert capsys.readouterr().err == ""
