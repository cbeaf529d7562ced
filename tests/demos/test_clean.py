"""Rows that are late, repeated or missing, and thinning."""

from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos, preview
from planspace.demos.dataset import Demos
from planspace.demos.episode import Origin
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError, UsageError


def load(tmp_path: Path, text: str, **options) -> Demos:
    (tmp_path / "a.csv").write_text(text)
    import_demos([str(tmp_path / "a.csv")], tmp_path / "out", None, ImportOptions(**options))
    return load_demos(tmp_path / "out")


def rows(times: list[float], header: str = "time,x,control1") -> str:
    """Rows with x = 10 t and the control 100 t."""
    return "\n".join([header, *(f"{t},{10 * t:.6g},{100 * t:.6g}" for t in times)])


def test_late_and_repeated_rows_are_sorted_and_reported(tmp_path: Path, capsys) -> None:
    times = [0.0, 0.1, 0.2, 0.4, 0.3, 0.5, 0.5, 0.6, 0.7, 0.8, 0.9]
    demos = load(tmp_path, rows(times))
    np.testing.assert_allclose(demos.times, 0.1 * np.arange(10))
    np.testing.assert_allclose(demos.states[:, 0], np.arange(10.0))
    np.testing.assert_allclose(demos.controls[:, 0], 10.0 * np.arange(9))
    err = capsys.readouterr().err
    assert "1 row is late: sorted by time (" in err and "a.csv, line 6)" in err
    assert "1 row has the time of the next one: left out (" in err and "a.csv, line 7)" in err


def test_the_last_of_repeated_rows_is_kept(tmp_path: Path) -> None:
    demos = load(tmp_path, "time,x,control1\n0,1,5\n0.1,2,6\n0.1,3,7\n0.2,4,8\n")
    assert demos.states[:, 0].tolist() == [1, 3, 4] and demos.controls[:, 0].tolist() == [5, 7]


def test_as_recorded_refuses_what_it_would_have_to_change(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"a\.csv, line 4: the time 0\.1 does not come after 0\.1"):
        load(tmp_path, rows([0.0, 0.1, 0.1, 0.2]), as_recorded=True)


WITH_GAP = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 2.5, 2.6, 2.7, 2.8, 2.9, 3.0]


def test_a_gap_is_refused_cut_or_filled(tmp_path: Path, capsys) -> None:
    with pytest.raises(PlanspaceError, match=r"1 gap \(.*a\.csv, line 8: 2 s\): .*than 0\.5 s.*--gaps"):
        load(tmp_path, rows(WITH_GAP))
    assert not (tmp_path / "out").exists()
    (tmp_path / "cut").mkdir()
    demos = load(tmp_path / "cut", rows(WITH_GAP), gaps="split")
    assert np.diff(demos.offsets).tolist() == [6, 6]
    np.testing.assert_allclose(demos.states[:, 0], 10 * np.array(WITH_GAP))
    np.testing.assert_allclose(demos.controls[:, 0], 100 * np.array([*WITH_GAP[:5], *WITH_GAP[6:11]]))
    assert "1 gap: the demonstration is cut there" in capsys.readouterr().err
    (tmp_path / "fill").mkdir()
    demos = load(tmp_path / "fill", rows(WITH_GAP), gaps="fill")
    np.testing.assert_allclose(demos.states[:, 0], np.arange(31.0), atol=1e-9)
    assert "1 gap: filled by interpolation" in capsys.readouterr().err


def test_steps_that_vary_on_purpose_are_no_gaps(tmp_path: Path, capsys) -> None:
    load(tmp_path, rows(np.cumsum([0.0, *([0.02, 0.2] * 8)]).tolist()))
    assert "gap" not in capsys.readouterr().err


def test_demonstrations_of_one_state_are_left_out(tmp_path: Path, capsys) -> None:
    text = "episode,time,x\n0,0,1\n0,1,2\n1,0,3\n2,0,4\n2,1,5\n"
    assert load(tmp_path, text).states[:, 0].tolist() == [1, 2, 4, 5]
    assert "1 demonstration has one state: left out (" in (err := capsys.readouterr().err)
    assert "a.csv, line 4)" in err


def test_thinning_leaves_out_states_and_keeps_the_last(tmp_path: Path) -> None:
    text = rows((np.arange(12) / 30).tolist())
    demos = load(tmp_path, text, rate=10.0)
    everything = np.loadtxt(text.splitlines()[1:], delimiter=",")
    # every third row counted back from row 11: 2, 5, 8, 11
    assert demos.states[:, 0].tolist() == everything[[2, 5, 8, 11], 1].tolist()
    assert demos.controls[:, 0].tolist() == everything[[2, 5, 8], 2].tolist()
    np.testing.assert_allclose(demos.times, [0, 0.1, 0.2, 0.3])
    with pytest.raises(UsageError, match=r"--rate 60 asks for more states than were recorded, 30 per second"):
        load(tmp_path, text, rate=60.0)


def test_thinning_interpolates_where_the_rates_do_not_divide(tmp_path: Path) -> None:
    demos = load(tmp_path, rows((np.arange(31) / 30).tolist()), rate=20.0)
    np.testing.assert_allclose(demos.times, np.arange(21) / 20)
    np.testing.assert_allclose(demos.states[:, 0], 10 * np.arange(21) / 20, atol=1e-4)


def test_a_preview_writes_nothing(tmp_path: Path, capsys) -> None:
    (tmp_path / "a.csv").write_text("episode,time,x\n0,0,1\n0,1,2\n1,0,3\n2,0,4\n2,1,5\n")
    table, num = preview([str(tmp_path / "a.csv")], None, ImportOptions())
    assert num == 2 and [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    assert table.splitlines()[-1].split()[:5] == ["x", "state", "1", "to", "5"]
    assert "has one state" in capsys.readouterr().err


def test_the_rows_of_states_are_stored_as_runs() -> None:
    origin = Origin.of_rows("a.csv", "line", np.array([2, 3, 4, 9, 8, 10, 11]))
    assert origin.starts == (0, 3, 4, 5) and [origin.row(i) for i in range(7)] == [2, 3, 4, 9, 8, 10, 11]
    assert origin.take(np.array([1, 6])).place(1) == "a.csv, line 11"


def test_outliers_are_kept_and_reported(tmp_path: Path, capsys) -> None:
    x = np.sin(np.arange(200) / 20)
    x[77] = 8.0
    text = "\n".join(["time,x", *(f"{i / 10},{value!r}" for i, value in enumerate(x.tolist()))])
    assert load(tmp_path, text).states[77, 0] == 8.0
    assert "1 outlier is kept: in x (" in (err := capsys.readouterr().err) and "a.csv, line 79: 8)" in err
    assert "ticks" not in err


def test_ticks_of_a_sensor_are_reported_and_those_of_a_switch_are_not(tmp_path: Path, capsys) -> None:
    x = np.round(np.sin(np.arange(300) / 30) / 0.02) * 0.02  # a sine of 1 in ticks of 0.02
    switch = (np.arange(300) % 50 < 25).astype(float)
    lines = [f"{i / 10},{a!r},{b}" for i, (a, b) in enumerate(zip(x.tolist(), switch.tolist(), strict=True))]
    load(tmp_path, "\n".join(["time,x,switch", *lines]))
    assert (
        "the sensor ticks are as large as most steps of x (0.02): a lower --rate" in capsys.readouterr().err
    )
