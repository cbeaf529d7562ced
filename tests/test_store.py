import errno
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planspace import store
from planspace.errors import PlanspaceError


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file.json"
    store.write_json(path, {"old": 1})

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for name in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, name, full if name == "fsync" else lambda *_: full(0))
            with pytest.raises(PlanspaceError, match="cannot write .*file.json: No space left on device"):
                store.write_json(path, {"new": 2})
        assert store.read_json(path) == {"old": 1}
        assert [p.name for p in tmp_path.iterdir()] == ["file.json"]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(min_size=1, max_size=6).filter(lambda k: k != "checksum"), JSON, max_size=4))
def test_sealed_json_round_trips(tmp_path_factory: pytest.TempPathFactory, value: dict[str, Any]) -> None:
    path = tmp_path_factory.mktemp("sealed") / "file.json"
    store.write_sealed(path, value)
    assert store.read_sealed(path) == value


def test_any_changed_byte_of_a_sealed_file_is_found(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    store.write_sealed(path, {"name": "swing-up", "number": 12, "list": [1, 2]})
    whole = path.read_bytes()
    missed = []
    for i in range(len(whole)):
        if whole[i : i + 1].isspace():
            continue  # white space outside strings carries nothing
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :])
        try:
            store.read_sealed(path)
        except PlanspaceError:
            continue
        missed.append(i)
    assert missed == []


def test_arrays_and_description_travel_together(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3).T, "b": np.array(True), "c": np.zeros((0, 2), np.int32)}
    sha256 = store.write_arrays(tmp_path / "f.safetensors", arrays, about={"step": 7})
    back = store.read_arrays(tmp_path / "f.safetensors", sha256=sha256)
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].dtype == array.dtype
    assert store.read_arrays_about(tmp_path / "f.safetensors")[1] == {"step": 7}


def test_truncated_arrays_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "f.safetensors"
    store.write_arrays(path, {"a": np.arange(6.0)})
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(PlanspaceError, match=r"f.safetensors was altered or damaged: no readable"):
            store.read_arrays(path)


def test_a_run_with_other_settings_is_refused_with_the_difference(tmp_path: Path) -> None:
    store.open_run(tmp_path / "run", {"seed": 0, "fit": {"steps": 10, "z_dim": 3}})
    store.open_run(tmp_path / "run", {"seed": 0, "fit": {"steps": 10, "z_dim": 3}})
    with pytest.raises(PlanspaceError, match=r"fit.z_dim was 3, now 10; seed was 0, now 1"):
        store.open_run(tmp_path / "run", {"seed": 1, "fit": {"steps": 10, "z_dim": 10}})


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(PlanspaceError, match=r"not a planspace run \(it holds 'thesis.tex'\)"):
        store.open_run(tmp_path, {})


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(PlanspaceError, match="cannot write .*file/run: Not a directory"):
        store.make_folder(tmp_path / "file" / "run")
