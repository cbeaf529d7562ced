import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planspace.errors import PlanspaceError
from planspace.storage.arrays import read_array, read_arrays, read_arrays_and_metadata, write_arrays
from planspace.storage.files import make_folder, read_bytes
from planspace.storage.json_files import read_json, read_sealed, write_json, write_sealed
from planspace.storage.rows import append_rows
from planspace.storage.runs import lock_folder, open_run


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file.json"
    write_json(path, {"old": 1})

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for name in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, name, full if name == "fsync" else lambda *_: full(0))
            with pytest.raises(PlanspaceError, match="cannot write .*file.json: No space left on device"):
                write_json(path, {"new": 2})
        assert read_json(path) == {"old": 1}
        assert [p.name for p in tmp_path.iterdir()] == ["file.json"]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(min_size=1, max_size=6).filter(lambda k: k != "checksum"), JSON, max_size=4))
def test_sealed_json_round_trips(tmp_path_factory: pytest.TempPathFactory, value: dict[str, Any]) -> None:
    path = tmp_path_factory.mktemp("sealed") / "file.json"
    write_sealed(path, value)
    assert read_sealed(path) == value


def test_every_changed_byte_of_a_sealed_file_is_found(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    write_sealed(path, {"name": "swing-up", "number": 12, "list": [1, 2]})
    whole = path.read_bytes()
    missed = []
    for i in range(len(whole)):
        if whole[i : i + 1].isspace():
            continue  # white space outside of strings has no meaning
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :])
        try:
            read_sealed(path)
        except PlanspaceError:
            continue
        missed.append(i)
    assert missed == []


def test_arrays_and_metadata_are_read_back(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3).T, "b": np.array(True), "c": np.zeros((0, 2), np.int32)}
    sha256 = write_arrays(tmp_path / "f.safetensors", arrays, metadata={"step": 7})
    back = read_arrays(tmp_path / "f.safetensors", sha256=sha256)
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].dtype == array.dtype
    assert read_arrays_and_metadata(tmp_path / "f.safetensors")[1] == {"step": 7}


def test_truncated_arrays_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "f.safetensors"
    write_arrays(path, {"a": np.arange(6.0)})
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(
            PlanspaceError, match=r"f.safetensors was altered or damaged: it is not a readable"
        ):
            read_arrays(path)


def test_a_run_with_other_settings_is_rejected_with_the_differences(tmp_path: Path) -> None:
    open_run(tmp_path / "run", {"seed": 0, "fit": {"steps": 10, "z_dim": 3}})
    open_run(tmp_path / "run", {"seed": 0, "fit": {"steps": 10, "z_dim": 3}})
    with pytest.raises(PlanspaceError, match=r"fit.z_dim was 3, now 10; seed was 0, now 1"):
        open_run(tmp_path / "run", {"seed": 1, "fit": {"steps": 10, "z_dim": 10}})


def test_a_folder_with_other_content_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(PlanspaceError, match=r"not a planspace run \(it holds 'thesis.tex'\)"):
        open_run(tmp_path, {})


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(PlanspaceError, match="cannot write .*file/run: Not a directory"):
        make_folder(tmp_path / "file" / "run")


READERS = {
    "json": read_json,
    "sealed": read_sealed,
    "arrays": read_arrays,
    "array": lambda path: read_array(path, "a"),
    "about": read_arrays_and_metadata,
    "bytes": read_bytes,
}


def write_all(folder: Path) -> dict[str, Path]:
    folder.mkdir()
    write_sealed(folder / "d.json", {"a": 1})
    write_arrays(folder / "a.safetensors", {"a": np.arange(3.0)}, metadata={"step": 1})
    return {
        kind: folder / ("d.json" if kind in ("json", "sealed", "bytes") else "a.safetensors")
        for kind in READERS
    }


@pytest.mark.parametrize("kind", READERS)
def test_a_folder_may_be_a_link_but_not_a_file_out_of_it(kind: str, tmp_path: Path) -> None:
    file = write_all(tmp_path / "target")[kind]
    (tmp_path / "link").symlink_to(file.parent)
    READERS[kind](tmp_path / "link" / file.name)
    (file.parent / "alias").symlink_to(file.name)
    READERS[kind](file.parent / "alias")
    (tmp_path / "folder").mkdir()
    link = tmp_path / "folder" / file.name
    link.symlink_to(file)
    with pytest.raises(PlanspaceError, match=f"{link} is a link out of its folder, to {file}; replace it"):
        READERS[kind](link)
    link.unlink()
    link.symlink_to(link)
    with pytest.raises(PlanspaceError, match=f"cannot read {link}: Too many levels of symbolic links"):
        READERS[kind](link)


@pytest.mark.parametrize("part", ["embedding", "embedding-0", "checkpoint"])
def test_a_part_of_a_run_must_lie_in_it(part: str, tmp_path: Path) -> None:
    file = write_all(tmp_path / "target")["sealed"]
    run = tmp_path / "run"
    run.mkdir()
    (run / part).symlink_to(file.parent)
    read_sealed(run / part / file.name)  # not part of a run
    for mark in ("config.json", "policies.json"):
        (run / mark).touch()
        with pytest.raises(
            PlanspaceError, match=f"run/{part} is a link out of its folder, to {file.parent};"
        ):
            read_sealed(run / part / file.name)
        (run / mark).unlink()


@pytest.mark.parametrize("kind", READERS)
def test_a_file_larger_than_memory_is_rejected(kind: str, tmp_path: Path) -> None:
    file = write_all(tmp_path / "d")[kind]
    os.truncate(file, 1 << 42)  # a sparse file
    with pytest.raises(PlanspaceError, match=f"{file} has {1 << 42} bytes; at most .* can be read here"):
        READERS[kind](file)


@pytest.mark.parametrize("read", [read_json, read_sealed])
def test_a_json_file_of_gigabytes_is_rejected(read: Any, tmp_path: Path) -> None:
    file = write_all(tmp_path / "d")["json"]
    os.truncate(file, 3 << 30)
    with pytest.raises(PlanspaceError, match=f"has {3 << 30} bytes; at most {1 << 28} can be read here"):
        read(file)


@pytest.mark.parametrize(("kind", "call"), [("json", "json.loads"), ("about", "safetensors.numpy.load")])
def test_too_little_memory_gives_one_line(
    kind: str, call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_all(tmp_path / "d")[kind]

    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(call, fail)
    with pytest.raises(PlanspaceError, match=f"not enough memory to read {file}"):
        READERS[kind](file)


def test_a_row_is_appended_once(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"

    def append(*steps: int) -> list[int]:
        append_rows(log, [{"step": step} for step in steps], key="step")
        return [json.loads(line)["step"] for line in log.read_text().splitlines()]

    assert append(1, 2) == [1, 2]
    assert append(1, 2) == [1, 2]  # as after an interrupt
    assert append(2, 3, 4) == [1, 2, 3, 4]
    log.write_text(log.read_text().replace("4", "9"))  # a damaged row must not keep others out
    assert append(4, 5) == [1, 2, 3, 9, 4, 5]
    log.write_text('[]\nnonsense\n{"other": 1}\n')
    append_rows(log, [{"step": 1}], key="step")
    assert len(log.read_text().splitlines()) == 4


def test_no_row_is_appended_outside_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    log = tmp_path / "run" / "log.jsonl"
    append_rows(log, [{"step": 1}], key="step")
    log.rename(tmp_path / "thesis")
    log.symlink_to(tmp_path / "thesis")
    for target in (tmp_path / "thesis", tmp_path / "new"):
        log.unlink()
        log.symlink_to(target)
        with pytest.raises(PlanspaceError, match="is a link out of its folder"):
            append_rows(log, [{"step": 2}], key="step")
    assert (tmp_path / "thesis").read_text() == '{"step": 1}\n' and not (tmp_path / "new").exists()


def test_a_lock_makes_no_file_outside_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".writing-lock").symlink_to(tmp_path / "new")
    with pytest.raises(PlanspaceError, match="cannot write .*run"), lock_folder(tmp_path / "run"):
        pass
    assert not (tmp_path / "new").exists()
