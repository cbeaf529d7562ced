import io
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_demos, import_demos, import_npz
from planspace.demos.csv_files import read_csv
from planspace.demos.dataset import Demos, StateInfo
from planspace.demos.describe import describe, validate
from planspace.demos.folder import DemoFolder, StoredDemos, keep_whole_shards, load_demos
from planspace.demos.npz_files import export_npz
from planspace.demos.recording import Imported, ImportOptions, assignments, recorded
from planspace.demos.triplets import random_triplets
from planspace.errors import PlanspaceError, UsageError

CSV = "time,x\n0,1\n0.1,2\n0.2,3\n"


def test_export_and_import_give_the_same_demonstrations(demos: Demos, tmp_path: Path) -> None:
    export_npz(demos, tmp_path / "demos.npz")
    import_npz(tmp_path / "demos.npz", tmp_path / "exact", demos.info)
    import_demos([str(tmp_path / "demos.npz")], tmp_path / "even", demos.info, ImportOptions())
    for folder in ("exact", "even"):  # plans are even and end in one turn: nothing is to be done to them
        back = load_demos(tmp_path / folder)
        for name in ("states", "controls", "times", "offsets"):
            np.testing.assert_array_equal(getattr(back, name), getattr(demos, name))


def test_imports_the_released_data(released: Path, tmp_path: Path, capsys) -> None:
    import_npz(released / "cartpole_swingup.npz", tmp_path / "demos", None)
    demos = load_demos(tmp_path / "demos")
    assert len(demos) == 400
    assert demos.info.names == ("state0", "state1", "state2", "state3")
    assert capsys.readouterr().err == ""
    # 348 of the 400 hold a shorter step; without a model the step is the median, float32's 0.02
    import_demos([str(released / "cartpole_swingup.npz")], tmp_path / "even", None, ImportOptions())
    assert capsys.readouterr().err == "resampled 348 of 400 demonstrations to a step of 0.02 s\n"
    even = load_demos(tmp_path / "even")
    ends = np.abs(even.states[even.offsets[1:] - 1] - demos.states[demos.offsets[1:] - 1])
    assert ends.max() < 1e-12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": None}, "has no array 'time'"),
        ({"offsets": np.array([0, 3])}, "offsets must run from 0 to the number of rows, 4"),
        ({"offsets": np.array([0, 1, 4])}, "episode 0 has fewer than two states"),
        ({"controls": np.zeros((3, 1))}, "the same number of rows"),
        ({"time": np.zeros((4, 1))}, "two, two and one axes"),
        ({"time": np.array([0.0, 1.0, 1.0, 2.0])}, "episode 0, row 2: the time 1 does not come after 1"),
        ({"states": np.array([[0.0], [1.0], [np.nan], [3.0]])}, "state that is not finite, in row 2"),
        ({"states": np.array([["a"]] * 4)}, "'states' is of type <U1; numbers are needed"),
        ({"states": np.array([[{}]] * 4, dtype=object)}, "not a readable NPZ archive of plain arrays"),
    ],
)
def test_bad_archives_are_refused(change: dict, message: str, tmp_path: Path) -> None:
    arrays = {
        "states": np.arange(4.0)[:, None],
        "controls": np.zeros((4, 1)),
        "time": np.arange(4.0),
        "offsets": np.array([0, 4]),
        **change,
    }
    np.savez(tmp_path / "bad.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(PlanspaceError, match=message):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(PlanspaceError, match="not a readable NPZ archive"):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)


@pytest.mark.parametrize(
    ("files", "sources", "message"),
    [
        ([], [], "which source"),
        ([], ["demos"], "demos is no source of demonstrations; it may be FILE.npz"),
        (["a.txt"], ["a.txt"], "a.txt is no source of demonstrations"),
        (["in/a.txt"], ["in"], "in is no source of demonstrations"),
        (["in/a.csv", "in/b.json"], ["in"], "in holds .csv and .json files; import one kind at a time"),
        (["a.npz", "b.npz"], ["a.npz", "b.npz"], "a.npz and 1 more holds 2 NPZ archives"),
        (["in/manifest.json"], ["in"], "is a planspace dataset already"),
    ],
)
def test_sources_of_no_kind_are_refused(
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
        ("a.npz", {"states": {"x": "y"}}, "--state has no meaning for a.npz"),
        ("a.npz", {"dt": 0.1}, "--dt has no meaning for a.npz, which has times of its own"),
        ("a.out", {"controls": {"x": "y"}}, "--control has no meaning for a.out"),
        ("minari:a-v0", {"controls": {"x": "y"}}, "--control has no meaning for minari:a-v0"),
    ],
)
def test_options_without_a_meaning_are_not_passed_over(
    source: str, options: dict, message: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=message):
        import_demos([source], tmp_path / "out", None, ImportOptions(**options))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"cannot read .*none\.csv: No such file"):
        import_demos([str(tmp_path / "none.csv")], tmp_path / "out", None, ImportOptions())


def test_the_same_import_again_changes_nothing_and_another_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(CSV)
    out = tmp_path / "out"
    import_demos([str(tmp_path / "a.csv")], out, None, ImportOptions())
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    import_demos([str(tmp_path / "a.csv")], out, None, ImportOptions())
    assert before == {p.name: p.read_bytes() for p in out.iterdir()}
    with pytest.raises(PlanspaceError, match="made with other settings: content was"):
        import_demos([str(tmp_path / "a.csv")], out, None, ImportOptions(states={"y": "x"}))
    assert describe(out)["made_by"] == {"imported": "a.csv"}


HEADERS = ("{[]:1}", "{1:2,'a':3}", "{'descr':(),'fortran_order':False,'shape':(60,)}", "x:\n  y\n z:\n")


def header(text: str) -> bytes:
    """Of an array in NumPy's format, 128 bytes long."""
    return b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + text.ljust(117).encode() + b"\n"


def archive(num: int, length: int = 20) -> dict[str, np.ndarray]:
    """`num` demonstrations of `length` states."""
    rows = num * length
    return {
        "states": np.random.default_rng(0).normal(size=(rows, 3)),
        "controls": np.ones((rows, 1)),
        "time": np.tile(0.1 * np.arange(length), num),
        "offsets": np.arange(num + 1) * length,
    }


def test_archives_may_be_compressed_and_lie_by_column(tmp_path: Path) -> None:
    arrays = archive(3)
    np.savez(tmp_path / "plain.npz", **arrays)
    np.savez_compressed(tmp_path / "packed.npz", **arrays)
    np.savez(tmp_path / "by_column.npz", **{**arrays, "states": np.asfortranarray(arrays["states"])})
    hashes = set()
    for name in ("plain", "packed", "by_column"):
        import_npz(tmp_path / f"{name}.npz", tmp_path / name, None)
        hashes.add(load_demos(tmp_path / name).hash)
    assert len(hashes) == 1
    np.testing.assert_array_equal(load_demos(tmp_path / "plain").states, arrays["states"])


def test_an_archive_of_which_a_bit_is_turned_leaves_nothing(tmp_path: Path) -> None:
    arrays = archive(3)
    np.savez(tmp_path / "bad.npz", **arrays)
    data = bytearray((tmp_path / "bad.npz").read_bytes())
    data[data.index(arrays["time"].tobytes()) + 3] ^= 1  # 0 becomes tiny: only a checksum can tell
    (tmp_path / "bad.npz").write_bytes(data)
    with pytest.raises(PlanspaceError, match="not a readable NPZ archive .*CRC"):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.npz"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-8], "shorter than it says"),
        (lambda data: data + bytes(8), "longer than it says"),
        *(
            (lambda data, text=text: header(text) + data[128:], "no.*readable NPZ archive")
            for text in HEADERS
        ),
    ],
)
def test_an_array_that_is_not_as_long_as_it_says_is_refused(
    change: Callable[[bytes], bytes], message: str, tmp_path: Path
) -> None:
    with zipfile.ZipFile(tmp_path / "bad.npz", "w") as target:
        for key, array in archive(3).items():
            file = io.BytesIO()
            np.save(file, array)
            data = file.getvalue()
            target.writestr(f"{key}.npy", change(data) if key == "time" else data)
    with pytest.raises(PlanspaceError, match=message):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.npz"]


def test_a_bad_demonstration_far_into_a_source_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planspace.demos.convert.SHARD_EPISODES", 2)
    arrays = archive(6)
    arrays["states"][-1, 0] = np.inf  # in the third shard
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(PlanspaceError, match=r"bad.npz: demonstration 5 holds a state that is not finite"):
        import_npz(tmp_path / "bad.npz", tmp_path / "deep" / "out", None)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.npz"]
    (tmp_path / "out").mkdir()
    with pytest.raises(PlanspaceError, match="not finite"):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)
    assert list((tmp_path / "out").iterdir()) == []


def test_what_a_kill_left_of_an_import_is_cleared_away(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **archive(3))
    import_npz(tmp_path / "a.npz", tmp_path / "alone", None)
    left = tmp_path / "out" / ".writing-import" / "recorded"
    left.mkdir(parents=True)
    (left / "manifest.json").write_text("half of a")
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    assert load_demos(tmp_path / "out").hash == load_demos(tmp_path / "alone").hash
    names = [sorted(path.name for path in (tmp_path / name).iterdir()) for name in ("out", "alone")]
    assert names[0] == names[1] == ["manifest.json", "shard-00000.safetensors"]


@pytest.mark.parametrize("link", [".writing-import", ".writing-import/recorded"])
def test_nothing_is_removed_through_a_link(link: str, tmp_path: Path) -> None:
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


def test_an_import_of_which_a_shard_was_damaged_is_made_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planspace.demos.convert.SHARD_EPISODES", 2)
    numbers = [0, 3, 5, 6, 9, 12]  # as of a dataset of which some plans had failed
    info, step = StateInfo(("x",), ("",), (), 1), np.arange(4.0)
    course = step[:, None], np.ones((3, 1)), step
    episodes = [recorded(*course, index=number) for number in numbers]
    monkeypatch.setattr("planspace.demos.convert.read_npz", lambda file, known: Imported(info, episodes))
    (tmp_path / "a.npz").touch()
    out = tmp_path / "out"
    import_npz(tmp_path / "a.npz", out, None)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    (out / "shard-00001.safetensors").write_bytes(b"")
    assert keep_whole_shards(out)
    import_npz(tmp_path / "a.npz", out, None)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_source_that_changes_while_it_is_read_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(CSV)
    imported = read_csv([file], None, ImportOptions())
    file.write_text("")
    with pytest.raises(PlanspaceError, match="was changed while it was read"):
        list(imported.episodes)


def test_times_that_would_fill_the_memory_are_refused(tmp_path: Path) -> None:
    rows = [f"{t},0" for t in ("0", "1e-6", "2e-6", "3e-6", "1e9")]
    (tmp_path / "a.csv").write_text("\n".join(["time,x", *rows]))
    with pytest.raises(PlanspaceError, match=r"demonstration 0 lasts 1e\+09 s, 1e\+15 steps of the 1e-06 s"):
        import_demos([str(tmp_path / "a.csv")], tmp_path / "out", None, ImportOptions())
    assert not (tmp_path / "out").exists()


def test_an_import_that_was_half_done_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planspace.demos.convert.SHARD_EPISODES", 2)
    np.savez(tmp_path / "a.npz", **archive(5))
    import_npz(tmp_path / "a.npz", tmp_path / "alone", None)
    append, done = DemoFolder.append, []

    def until_the_second(self: DemoFolder, episodes: list, next_index: int) -> None:
        if self.path == tmp_path / "out":
            done.append(next_index)
            if len(done) == 2:
                raise KeyboardInterrupt
        append(self, episodes, next_index)

    with monkeypatch.context() as patch:
        patch.setattr(DemoFolder, "append", until_the_second)
        with pytest.raises(KeyboardInterrupt):
            import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    assert len(load_demos(tmp_path / "out")) == 2
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    assert load_demos(tmp_path / "out").hash == load_demos(tmp_path / "alone").hash


def test_memory_stays_flat_however_long_the_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planspace.demos.convert.SHARD_EPISODES", 100)

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
    for num in (200, 200, 4000):  # the first to have everything imported and cached
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
        # beside one shard a few numbers of each demonstration; the whole dataset is 3 MB
        assert large < 1.2 * small + 4000 * 64 < 0.5 * whole


def test_exports_of_no_kind_are_refused(demos: Demos, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"demos\.txt has no kind .* FILE\.npz, FILE\.csv or minari:ID"):
        export_demos(demos, str(tmp_path / "demos.txt"))
    with pytest.raises(PlanspaceError, match="cannot write"):
        export_demos(demos, str(tmp_path / "nowhere" / "demos.csv"))
    assert list(tmp_path.iterdir()) == []


def test_assignments_are_names_and_columns() -> None:
    assert assignments("--state", ["x=a=b", "y = c"]) == {"x": "a=b", "y": "c"}
    for texts, message in ((["x"], "needs NAME=COLUMN, got 'x'"), (["x=1", "x=2"], "names 'x' twice")):
        with pytest.raises(UsageError, match=f"--state {message}"):
            assignments("--state", texts)
    with pytest.raises(UsageError, match="--dt must be a positive number"):
        ImportOptions(dt=float("nan"))


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_an_archive_is_compressed_as_numpy_does(compression: int, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **archive(3))
    with zipfile.ZipFile(tmp_path / "a.npz") as source, zipfile.ZipFile(tmp_path / "b.npz", "w") as target:
        for name in source.namelist():
            target.writestr(name, source.read(name), compress_type=compression)
    with pytest.raises(PlanspaceError, match=r"states\.npy is compressed otherwise than NumPy does"):
        import_npz(tmp_path / "b.npz", tmp_path / "out", None)


def test_an_archive_that_says_more_than_deflate_can_hold_is_refused(tmp_path: Path) -> None:
    zeros = archive(2000)["states"] * 0  # compresses as well as anything
    np.savez_compressed(tmp_path / "a.npz", **{**archive(2000), "states": zeros})
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    with zipfile.ZipFile(tmp_path / "a.npz") as source:
        size = source.getinfo("states.npy").file_size
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "b.npz").write_bytes(
        data.replace(size.to_bytes(4, "little"), (1 << 31).to_bytes(4, "little"))
    )
    with pytest.raises(PlanspaceError, match=r"states\.npy says that it has more bytes than the archive can"):
        import_npz(tmp_path / "b.npz", tmp_path / "out", None)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_demonstration_larger_than_memory_is_not_read(
    order: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrays = archive(1)
    np.savez(tmp_path / "a.npz", **{**arrays, "states": np.asarray(arrays["states"], order=order)})
    size = 8 * arrays["states"].size
    for name in ("MAX_EPISODE_BYTES", "MAX_BYTES"):
        monkeypatch.setattr(f"planspace.demos.npz_files.{name}", size)
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    monkeypatch.setattr(
        f"planspace.demos.npz_files.{'MAX_EPISODE_BYTES' if order == 'C' else 'MAX_BYTES'}", size - 1
    )
    with pytest.raises(
        PlanspaceError, match=r"a\.npz is not .*\d numbers at once are too many for this mach"
    ):
        import_npz(tmp_path / "a.npz", tmp_path / "out", None)


def test_a_lack_of_memory_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("planspace.demos.convert.check_episode", fail)
    (tmp_path / "a.csv").write_text(CSV)
    with pytest.raises(PlanspaceError, match=r"not enough memory to read .*a\.csv"):
        import_demos([str(tmp_path / "a.csv")], tmp_path / "out", None, ImportOptions())
    assert not (tmp_path / "out").exists()


def test_numbers_that_overflow_are_refused_without_a_warning(tmp_path: Path) -> None:
    info = StateInfo(("x",), ("rad",), (0,), 1)
    (tmp_path / "a.csv").write_text("time,x\n-1.7e308,-1e308\n0,1e308\n1.7e308,-1e308\n")
    with pytest.raises(PlanspaceError, match="time that is not finite"):
        import_demos([str(tmp_path / "a.csv")], tmp_path / "out", info, ImportOptions())
