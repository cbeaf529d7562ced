from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_npz, import_npz
from planspace.demos.dataset import Demos, load_demos
from planspace.errors import PlanspaceError


def test_export_and_import_give_the_same_demonstrations(demos: Demos, tmp_path: Path) -> None:
    export_npz(demos, tmp_path / "demos.npz")
    import_npz(tmp_path / "demos.npz", tmp_path / "back", demos.info)
    back = load_demos(tmp_path / "back")
    for name in ("states", "controls", "times", "offsets"):
        np.testing.assert_array_equal(getattr(back, name), getattr(demos, name))


def test_imports_the_released_data(released: Path, tmp_path: Path) -> None:
    import_npz(released / "cartpole_swingup.npz", tmp_path / "demos", None)
    demos = load_demos(tmp_path / "demos")
    assert len(demos) == 400
    assert demos.info.names == ("state0", "state1", "state2", "state3")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": None}, "has no array 'time'"),
        ({"offsets": np.array([0, 3])}, "offsets must run from 0 to the number of rows, 4"),
        ({"offsets": np.array([0, 1, 4])}, "episode 0 has fewer than two states"),
        ({"controls": np.zeros((3, 1))}, "the same number of rows"),
        ({"states": np.array([[0.0], [1.0], [np.nan], [3.0]])}, "state that is not finite, in row 2"),
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
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_a_file_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(PlanspaceError, match="not a readable NPZ archive"):
        import_npz(tmp_path / "bad.npz", tmp_path / "out", None)
