import subprocess
import sys
from pathlib import Path

import pytest

from planspace.errors import PlanspaceError
from planspace.storage import tracking as track
from planspace.storage.tracking import open_tracker, open_trackers, open_wandb

pytest.importorskip("tensorboard")


def read(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Read the scalars with TensorBoard's own reader."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    accumulator = EventAccumulator(str(folder))
    accumulator.Reload()
    names = accumulator.Tags()["scalars"]
    return {name: [(e.step, e.value) for e in accumulator.Scalars(name)] for name in names}


def test_added_scalars_are_read_back(tmp_path: Path) -> None:
    with open_tracker(tmp_path / "run") as tracker:
        tracker.add(500, {"seed 0/bound": -1.5, "seed 1/bound": -2.5})
        tracker.add(1000, {"seed 0/bound": -0.5, "path_error": 0.25})
    assert read(tmp_path / "run") == {
        "seed 0/bound": [(500, -1.5), (1000, -0.5)],
        "seed 1/bound": [(500, -2.5)],
        "path_error": [(1000, 0.25)],
    }


def test_a_crash_loses_nothing(tmp_path: Path) -> None:
    tracker = open_tracker(tmp_path)
    tracker.add(500, {"bound": -1.5})
    assert read(tmp_path) == {"bound": [(500, -1.5)]}  # before anything is closed
    tracker.close()


def test_an_interrupted_run_is_continued(tmp_path: Path) -> None:
    """The first process reached 1500, its checkpoint 500; the second repeats 1000 with another value."""
    for steps, value in (((500, 1000, 1500), 1.0), ((1000, 1500, 2000), 2.0)):
        with open_tracker(tmp_path) as tracker:
            for step in steps:
                tracker.add(step, {"bound": value})
    assert read(tmp_path) == {"bound": [(500, 1.0), (1000, 2.0), (1500, 2.0), (2000, 2.0)]}


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(PlanspaceError, match="cannot write .*Not a directory"):
        open_tracker(tmp_path / "file" / "run")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_gives_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    message = r"^cannot write \S+/events\.out\S+: No space left on device\.$"
    with (
        open("/dev/full", "wb") as full,
        pytest.raises(PlanspaceError, match=message),
        open_tracker(tmp_path) as tracker,
    ):
        tracker._records._writer.close()
        monkeypatch.setattr(tracker._records, "_writer", full)
        tracker.add(1, {"bound": 1.0})


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in sys.modules if n.startswith("tensorboard.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    with pytest.raises(PlanspaceError, match=r"^[^\n]*pip install .*\[track\]'\.$"):
        open_tracker(tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_tensorflow_and_torch_are_not_needed(tmp_path: Path) -> None:
    code = (
        "import sys\nfor name in ('tensorflow', 'torch'): sys.modules[name] = None\n"
        "import pathlib, planspace.storage.tracking as t\nassert 'tensorboard' not in sys.modules\n"
        f"with t.open_tracker(pathlib.Path({str(tmp_path)!r})) as tracker: tracker.add(3, {{'a': 1.0}})"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert read(tmp_path) == {"a": [(3, 1.0)]}


@pytest.fixture
def logged_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No user is logged in to Weights & Biases, and standard input is closed."""
    for name in ("WANDB_API_KEY", "WANDB_MODE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("sys.stdin", None)


def test_wandb_runs_offline_without_a_login(logged_out: None, tmp_path: Path) -> None:
    wandb = pytest.importorskip("wandb")

    with open_trackers(("wandb",), tmp_path / "run") as add:
        add(4000, {"return/seed 0": -1.5})
        add(8000, {"return/seed 0": -0.5})
    wandb.teardown()  # its service process may still be writing
    (path,) = (tmp_path / "run" / "wandb").glob("offline-run-*/run-*.wandb")
    data = path.read_bytes()  # protocol buffers store text as it is
    assert b"return/seed 0" in data and data.index(b"-1.5") < data.index(b"-0.5")


def test_wandb_credentials_are_found(logged_out: None, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not track._has_wandb_credentials()
    monkeypatch.setenv("WANDB_API_KEY", "0" * 40)
    assert track._has_wandb_credentials()
    monkeypatch.delenv("WANDB_API_KEY")
    netrc = Path.home() / ".netrc"
    netrc.write_text("machine api.wandb.ai login user password " + "0" * 40)
    netrc.chmod(0o600)
    assert track._has_wandb_credentials()
    netrc.write_text("not a netrc file")
    assert not track._has_wandb_credentials()


def test_several_trackers_and_none(logged_out: None, tmp_path: Path) -> None:
    pytest.importorskip("wandb")
    with open_trackers(("tensorboard", "wandb", "tensorboard"), tmp_path / "both") as add:
        add(1, {"a": 2.0})
    assert read(tmp_path / "both" / "tensorboard") == {"a": [(1, 2.0)]}
    assert (tmp_path / "both" / "wandb").exists()
    with open_trackers((), tmp_path / "none") as add:
        add(1, {"a": 2.0})
    assert not (tmp_path / "none").exists()


def test_a_missing_wandb_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(PlanspaceError, match=r"needs the package wandb: pip install .*\[track\]'"):
        open_wandb(tmp_path / "run")
    assert list(tmp_path.iterdir()) == []
