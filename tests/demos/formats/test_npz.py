import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos, import_npz
from planspace.demos.dataset import Demos
from planspace.demos.formats.npz import write_npz
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError
from tests.demos.archives import archive


def test_export_and_import_give_the_same_demonstrations(demos: Demos, tmp_path: Path) -> None:
    write_npz(demos, str(tmp_path / "demos.npz"))
    import_npz(tmp_path / "demos.npz", tmp_path / "exact", demos.info)
    import_demos([str(tmp_path / "demos.npz")], tmp_path / "even", demos.info, ImportOptions())
    for folder in (
        "exact",
        "even",
    ):  # plans have even steps and end in (-pi, pi], so the import changes nothing
        back = load_demos(tmp_path / folder)
        for name in ("states", "controls", "times", "offsets"):
            np.testing.assert_array_equal(getattr(back, name), getattr(demos, name))


def test_import_the_released_data(released: Path, tmp_path: Path, capsys) -> None:
    import_npz(released / "cartpole_swingup.npz", tmp_path / "demos", None)
    demos = load_demos(tmp_path / "demos")
    assert len(demos) == 400
    assert demos.info.names == ("state0", "state1", "state2", "state3")
    assert capsys.readouterr().err == ""
    # 348 of the 400 contain a shorter step; without a model the step is the median, 0.02 in float32
    import_demos([str(released / "cartpole_swingup.npz")], tmp_path / "even", None, ImportOptions())
    assert capsys.readouterr().err == "resampled 348 of 400 demonstrations to a step of 0.02 s\n"
    even = load_demos(tmp_path / "even")
    ends = np.abs(even.states[even.offsets[1:] - 1] - demos.states[demos.offsets[1:] - 1])
    assert ends.max() < 1e-12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": None}, "has no column with the name of a time; its columns are states, controls. Give"),
        ({"offsets": np.array([0, 3])}, "offsets must run from 0 to the number of rows, 4"),
        ({"offsets": np.array([0, 1, 4])}, "episode 0 has fewer than two states"),
        ({"controls": np.zeros((3, 1))}, "the same number of rows"),
        ({"time": np.zeros((4, 1))}, "two, two and one axes"),
        ({"time": np.array([0.0, 1.0, 1.0, 2.0])}, "episode 0, row 2: the time 1 does not come after 1"),
        (
            {"states": np.array([[0.0], [1.0], [np.nan], [3.0]])},
            "demonstration 0, row 2: state0 is not finite",
        ),
        ({"states": np.array([["a"]] * 4)}, "'states' must contain numbers, got type <U1"),
        ({"states": np.array([[{}]] * 4, dtype=object)}, "not a readable NPZ archive of plain arrays"),
    ],
)
def test_invalid_archives_are_refused(change: dict, message: str, tmp_path: Path) -> None:
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


def test_a_file_that_is_not_an_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(PlanspaceError, match="not a readable NPZ archive"):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)


HEADERS = ("{[]:1}", "{1:2,'a':3}", "{'descr':(),'fortran_order':False,'shape':(60,)}", "x:\n  y\n z:\n")


def header(text: str) -> bytes:
    """The header of an array in NumPy's format, 128 bytes long."""
    return b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + text.ljust(117).encode() + b"\n"


def test_archives_may_be_compressed_and_in_fortran_order(tmp_path: Path) -> None:
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


def test_an_archive_with_a_flipped_bit_leaves_no_files(tmp_path: Path) -> None:
    arrays = archive(3)
    np.savez(tmp_path / "bad.npz", **arrays)
    data = bytearray((tmp_path / "bad.npz").read_bytes())
    data[data.index(arrays["time"].tobytes()) + 3] ^= 1  # 0 becomes tiny, which only the checksum reveals
    (tmp_path / "bad.npz").write_bytes(data)
    with pytest.raises(PlanspaceError, match="not a readable NPZ archive .*CRC"):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.npz"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-8], "shorter than its header says"),
        (lambda data: data + bytes(8), "longer than its header says"),
        *(
            (lambda data, text=text: header(text) + data[128:], "no.*readable NPZ archive")
            for text in HEADERS
        ),
    ],
)
def test_an_array_with_a_wrong_header_is_refused(
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


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions_are_refused(compression: int, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **archive(3))
    with zipfile.ZipFile(tmp_path / "a.npz") as source, zipfile.ZipFile(tmp_path / "b.npz", "w") as target:
        for name in source.namelist():
            target.writestr(name, source.read(name), compress_type=compression)
    with pytest.raises(PlanspaceError, match=r"states\.npy has a compression that NumPy does not use"):
        import_npz(tmp_path / "b.npz", tmp_path / "out", None)


def test_an_archive_that_claims_more_than_deflate_can_contain_is_refused(tmp_path: Path) -> None:
    zeros = archive(2000)["states"] * 0  # has the best possible compression
    np.savez_compressed(tmp_path / "a.npz", **{**archive(2000), "states": zeros})
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    with zipfile.ZipFile(tmp_path / "a.npz") as source:
        size = source.getinfo("states.npy").file_size
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "b.npz").write_bytes(
        data.replace(size.to_bytes(4, "little"), (1 << 31).to_bytes(4, "little"))
    )
    with pytest.raises(PlanspaceError, match=r"states\.npy claims more bytes than the archive can"):
        import_npz(tmp_path / "b.npz", tmp_path / "out", None)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_demonstration_that_does_not_fit_in_memory_is_refused(
    order: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrays = archive(1)
    np.savez(tmp_path / "a.npz", **{**arrays, "states": np.asarray(arrays["states"], order=order)})
    size = 8 * arrays["states"].size
    for name in ("MAX_EPISODE_BYTES", "MAX_BYTES"):
        monkeypatch.setattr(f"planspace.demos.formats.npz_file.{name}", size)
    import_npz(tmp_path / "a.npz", tmp_path / "out", None)
    monkeypatch.setattr(
        f"planspace.demos.formats.npz_file.{'MAX_EPISODE_BYTES' if order == 'C' else 'MAX_BYTES'}", size - 1
    )
    with pytest.raises(
        PlanspaceError, match=r"a\.npz is not .*an array of \d+ numbers does not fit in memory"
    ):
        import_npz(tmp_path / "a.npz", tmp_path / "out", None)
