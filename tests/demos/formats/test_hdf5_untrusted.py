"""HDF5 files that refer to other files, or that declare or contain more than they may."""

import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError

from .hdf5_files import MESH, rows, write, write_d4rl

h5py = pytest.importorskip("h5py")


def external_link(group, elsewhere: Path) -> None:
    group["states"] = h5py.ExternalLink(str(elsewhere), "secret")


def soft_link(group, elsewhere: Path) -> None:
    group["states"] = h5py.SoftLink("/data/demo_1/actions")


def two_names(group, elsewhere: Path) -> None:
    group["states"] = group["actions"]


def external_array(group, elsewhere: Path) -> None:
    group.create_dataset("states", (4, 18), "f8", external=[(str(elsewhere), 0, 576)])


def virtual_array(group, elsewhere: Path) -> None:
    layout = h5py.VirtualLayout((4, 18), "f8")
    layout[:] = h5py.VirtualSource(str(elsewhere), "secret", (4, 18))
    group.create_virtual_dataset("states", layout)


def huge_array(group, elsewhere: Path) -> None:
    group.create_dataset("states", (10**11, 18), "f8", chunks=(1000, 18))


def objects(group, elsewhere: Path) -> None:
    group.create_dataset("states", (4, 18), h5py.string_dtype())


def references(group, elsewhere: Path) -> None:
    group.create_dataset("states", (4, 18), h5py.ref_dtype)


def vectors(group, elsewhere: Path) -> None:
    group.create_dataset("states", (4,), h5py.vlen_dtype(np.float64))


def records(group, elsewhere: Path) -> None:
    group.create_dataset("states", (4,), np.dtype([("time", "f8"), ("x", "f8")]))


def other_filter(group, elsewhere: Path) -> None:
    group.create_dataset("states", data=rows(), compression="lzf")


def bomb(group, elsewhere: Path) -> None:
    array = group.create_dataset("states", (4, 18), "f8", chunks=(4, 18), compression="gzip")
    array.id.write_direct_chunk((0, 0), zlib.compress(bytes(1_000_000)))


def damaged_chunk(group, elsewhere: Path) -> None:
    array = group.create_dataset("states", (4, 18), "f8", chunks=(4, 18), compression="gzip")
    array.id.write_direct_chunk((0, 0), b"not deflate")


def long_chunk(group, elsewhere: Path) -> None:
    array = group.create_dataset("states", (4, 18), "f8", chunks=(4, 18), compression="gzip")
    array.id.write_direct_chunk((0, 0), bytes(10_000))


def a_group(group, elsewhere: Path) -> None:
    group.create_group("states/states")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (external_link, "'data/demo_1/states' is a link"),
        (soft_link, "'data/demo_1/states' is a link"),
        (two_names, "'data/demo_1/.*' has two names"),
        (external_array, "keeps its numbers in another file"),
        (virtual_array, "keeps its numbers in another file"),
        (huge_array, "declares an array of shape .* bytes that can be read"),
        (objects, "must contain rows of numbers, got references or texts"),
        (references, "must contain rows of numbers, got references or texts"),
        (vectors, "must contain rows of numbers, got references or texts"),
        (records, "must contain rows of numbers, got type .*time"),
        (other_filter, "is compressed with 'lzf'; planspace reads gzip only"),
        (bomb, "has a chunk that expands to more than it declares"),
        (damaged_chunk, "'data/demo_1/states' is damaged"),
        (long_chunk, "has a chunk that is larger than it declares"),
        (a_group, "has no array 'states'"),
    ],
)
def test_hostile_arrays_are_refused(change, message: str, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "secret.h5", "w") as secret:
        secret["secret"] = rows()
    write(tmp_path / "a.hdf5")
    with h5py.File(tmp_path / "a.hdf5", "a") as opened:
        del opened["data/demo_1/states"]
        change(opened["data/demo_1"], tmp_path / "secret.h5")
    with pytest.raises(PlanspaceError, match=message) as caught:
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / "out", None, ImportOptions())
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_link_out_of_a_d4rl_file_is_refused(tmp_path: Path) -> None:
    write_d4rl(tmp_path / "a.hdf5", **{"infos/qpos": None})
    with h5py.File(tmp_path / "a.hdf5", "a") as opened:
        opened["infos/qpos"] = h5py.ExternalLink("/etc/other.hdf5", "qpos")
    with pytest.raises(PlanspaceError, match="'infos/qpos' is a link"):
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / "out", None, ImportOptions())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '<mujoco><include file="/etc/passwd"/></mujoco>',
            "the joints of .* cannot be read: .*include",
        ),
        ("<mujoco>" + "<a>" * 300, "nested more than 200 levels"),
        ("<mujoco", "not well-formed XML"),
        (np.arange(3), "'model_file' of 'data/demo_1' must be a text"),
        (np.array([b"a", b"b"]), "'model_file' of 'data/demo_1' must be a text"),
        (b"<mujoco>\xff", "is not UTF-8 text"),
    ],
)
def test_hostile_models_are_refused(text, message: str, tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5")
    with h5py.File(tmp_path / "a.hdf5", "a") as opened:
        opened["data/demo_1"].attrs["model_file"] = text
    with pytest.raises(PlanspaceError, match=message):
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / "out", None, ImportOptions())


@pytest.mark.parametrize("name", ["../secret.xml", "/etc/passwd", "..", "link.xml"])
def test_the_name_of_a_model_does_not_lead_elsewhere(name: str, tmp_path: Path) -> None:
    (tmp_path / "secret.xml").write_text("<secret/>")
    (tmp_path / "here" / "models").mkdir(parents=True)
    (tmp_path / "here" / "models" / "link.xml").symlink_to(tmp_path / "secret.xml")
    write(tmp_path / "here" / "a.hdf5", name)
    try:
        import_demos([str(tmp_path / "here" / "a.hdf5")], tmp_path / "out", None, ImportOptions())
    except PlanspaceError as error:
        assert "is a link out of its folder" in str(error)
    else:
        assert name != "link.xml"


def test_names_that_are_not_utf8_are_listed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.hdf5", "w") as opened:
        opened.create_group(b"\xff\xfe")
        opened.create_group("episodes")
    with pytest.raises(PlanspaceError, match="unknown layout: it contains .*xff.*episodes"):
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / "out", None, ImportOptions())


@pytest.mark.parametrize("content", [b"", b"not HDF5", b"\x89HDF\r\n\x1a\n" + bytes(500)])
def test_a_file_that_is_not_hdf5_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.hdf5").write_bytes(content)
    with pytest.raises(PlanspaceError, match=r"a\.hdf5") as caught:
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / "out", None, ImportOptions())
    assert "\n" not in str(caught.value)


def test_a_missing_h5py_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "a.hdf5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(PlanspaceError, match=r"need the package h5py: pip install .*\[data\]'"):
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / "out", None, ImportOptions())


def test_h5py_is_imported_only_for_hdf5_files() -> None:
    code = "import sys, planspace.demos.convert; sys.exit('h5py' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- --untrusted ------------------------------------------------------------------------------------


def test_a_subprocess_reads_the_same_demonstrations(tmp_path: Path, capsys) -> None:
    write(tmp_path / "a.hdf5", MESH)
    read = {}
    for untrusted in (False, True):
        out, options = tmp_path / str(untrusted), ImportOptions(filter_key="train", untrusted=untrusted)
        import_demos([str(tmp_path / "a.hdf5")], out, None, options)
        read[untrusted] = load_demos(out).hash, capsys.readouterr().err
    assert read[True] == read[False]
    assert "no model" in read[True][1]


def test_a_subprocess_says_what_is_wrong(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5", states=np.full((4, 18), np.nan))
    with pytest.raises(PlanspaceError, match="demonstration 0, row 0: turn is not finite"):
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / "out", None, ImportOptions(untrusted=True))


def test_a_reader_that_crashes_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "a.hdf5")
    monkeypatch.setattr("planspace.storage.limited.sys.executable", "/bin/false")
    with pytest.raises(PlanspaceError, match="a.hdf5 cannot be read within 600 s .* or crashes the reader"):
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / "out", None, ImportOptions(untrusted=True))
