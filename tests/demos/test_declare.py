"""What columns mean: declared by the user, or guessed from names and values."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos, preview
from planspace.demos.dataset import Demos
from planspace.demos.formats.format import Column
from planspace.demos.guess import guess_kind, guess_quaternions, guess_unit, is_compass_angle, split_unit
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError, UsageError
from planspace.physics.quaternion import exp

CASES = Path(__file__).parents[3] / "shared" / "cases" / "data"


def write(file: Path, header: str, rows: np.ndarray) -> str:
    file.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows.tolist())]))
    return str(file)


def load(tmp_path: Path, header: str, rows: np.ndarray, **options) -> Demos:
    source = write(tmp_path / "a.csv", header, rows)
    import_demos([source], tmp_path / "out", None, ImportOptions(**options))
    return load_demos(tmp_path / "out")


def table(tmp_path: Path, header: str, rows: np.ndarray, **options) -> dict[str, str]:
    """The rows of the printed table by column."""
    lines = preview([write(tmp_path / "a.csv", header, rows)], None, ImportOptions(**options))[0].splitlines()
    return {line.split()[0]: " ".join(line.split()[1:]) for line in lines}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "time") for name in ("time", "T", "timestamp", "timeStamp", "t_ms", "header.stamp")),
        *((name, "unused") for name in ("frame_index", "index", "", "step", "next.reward", "done", "seq")),
        *((name, "episode") for name in ("episode", "episode_index", "demo", "traj_id", "trial")),
        *((name, "control") for name in ("control1", "action_0", "actions[3]", "ctrl2")),
        *((name, None) for name in ("x", "θ", "tcp", "stepper_angle", "timeconst", "q0", "index_finger")),
    ],
)
def test_kinds_are_guessed_from_whole_names(name: str, kind: str | None) -> None:
    assert guess_kind(Column(name)) == kind


def test_units_angles_and_quaternions_are_guessed_from_names() -> None:
    assert split_unit("yaw [deg]") == Column("yaw", "deg") and split_unit("obs[3]") == Column("obs[3]")
    assert guess_unit(Column("timestamp_ns")).unit == "ns" and guess_unit(Column("yaw_deg")).unit == "deg"
    assert guess_unit(Column("mean_ms")).unit == ""  # a unit of time on a column that is not a time
    assert is_compass_angle("base.yaw_deg") and not is_compass_angle("yaw_rate")
    assert guess_quaternions(["x", "qw", "qx", "qy", "qz"]) == [(1, 2, 3, 4)]
    ros = [f"pose.orientation.{axis}" for axis in "xyzw"]
    assert guess_quaternions([*ros, "w", "x", "y", "z"]) == [(3, 0, 1, 2)]  # plain w, x, y, z can be anything


def lerobot_rows() -> np.ndarray:
    """Three demonstrations of a joint that goes out and back: timestamp, frame_index, episode_index, pan."""
    rows = [[i / 30, i, e, np.sin(i / 5 + e)] for e, num in enumerate((20, 25, 30)) for i in range(num)]
    return np.array(rows)


LEROBOT = "timestamp,frame_index,episode_index,pan"


@pytest.mark.parametrize("options", [{}, {"dt": 1 / 30}])
def test_clocks_and_counters_are_no_states(options: dict, tmp_path: Path) -> None:
    demos = load(tmp_path, LEROBOT, lerobot_rows(), **options)
    assert demos.info.names == ("pan",)
    assert np.diff(demos.offsets).tolist() == [20, 25, 30]
    np.testing.assert_array_equal(demos.states[:, 0], lerobot_rows()[:, 3])
    assert demos.times[19] == pytest.approx(19 / 30)


def test_a_demonstration_begins_where_the_named_clock_goes_back(tmp_path: Path) -> None:
    rows = lerobot_rows()[:, [0, 1, 3]]
    for name, folder in (("timestamp", "a"), ("frame_index", "b")):
        (tmp_path / folder).mkdir()
        demos = load(tmp_path / folder, "timestamp,frame_index,pan", rows, episode=name)
        assert np.diff(demos.offsets).tolist() == [20, 25, 30]
    with pytest.raises(PlanspaceError, match=r"a\.csv, line 22: the time goes back from 0\.633\d+ to 0 s"):
        load(tmp_path, "timestamp,frame_index,pan", rows)


def test_a_column_that_rises_evenly_is_pointed_out(tmp_path: Path) -> None:
    rows = np.stack([0.1 * np.arange(5), [1, 5, 2, 0, 3]], axis=1)
    assert "rises evenly, like a clock; --time or --drop a?" in table(tmp_path, "a,b", rows, dt=0.1)["a"]
    assert table(tmp_path, "a,b", rows, time="a") == {
        "column": "kind unit range why",
        "a": "time s up to 0.4 s",
        "b": "state 0 to 5",
    }


def test_the_user_overrules_guesses(tmp_path: Path) -> None:
    rows = np.array([[0.0, 1, 2, 3], [0.1, 4, 5, 7]])
    demos = load(tmp_path, "stamp,step,x,y", rows, keep=["step"], drop=["y"], units={"x": "m"})
    assert demos.info.names == ("step", "x") and demos.info.units == ("", "m")
    for options, message in (
        ({"drop": ["z"]}, "--drop: unknown column 'z'"),
        ({"circular": ["x_"]}, "--circular: unknown state 'x_'. Did you mean 'x'"),
        ({"circular": ["x"], "linear": ["x"]}, "both name 'x'"),
        ({"circular": ["x"], "units": {"x": "m"}}, "'x' has the unit 'm', which is not that of an angle"),
        ({"quaternions": ["x:y"]}, "a quaternion is four neighbouring states, but 'x' is state 0 and 'y' is"),
        ({"quaternions": ["x"]}, "--quaternion needs FIRST:LAST"),
        ({"units": {"stamp": "m"}}, "'m' is not a unit of time"),
    ):
        with pytest.raises(PlanspaceError, match=message):
            preview([str(tmp_path / "a.csv")], None, ImportOptions(**options))


@pytest.mark.parametrize(
    ("header", "stamps", "options"),
    [
        ("timestamp_ms", [5000, 5100, 5200], {}),
        ("t", [5000, 5100, 5200], {"units": {"t": "ms"}}),
        ("stamp", [1764389000.0, 1764389000.1, 1764389000.2], {}),
        ("stamp", [1764389000000, 1764389000100, 1764389000200], {}),
        ("%time", [1764389000000000000, 1764389000100000000, 1764389000200000000], {}),
    ],
)
def test_times_are_converted_to_seconds(header: str, stamps: list, options: dict, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join([f"{header},x", *(f"{stamp},1" for stamp in stamps)]))
    import_demos([str(tmp_path / "a.csv")], tmp_path / "out", None, ImportOptions(**options))
    # the float nearest to nanoseconds since 1970 is up to 128 ns away
    np.testing.assert_allclose(load_demos(tmp_path / "out").times, [0, 0.1, 0.2], atol=3e-7)


def test_a_time_that_may_have_another_unit_is_pointed_out(tmp_path: Path) -> None:
    rows = np.array([[33.0 * i, i**2] for i in range(5)])
    assert table(tmp_path, "t,x", rows)["t"].endswith("steps of 33 s; --unit t=ms?")


def turning_robot(unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of time and wrapped heading with uneven times, and the continuous heading."""
    times = np.cumsum(np.random.default_rng(0).uniform(0.04, 0.16, 80))
    heading = 2.5 + 0.5 * times
    wrapped = (heading + np.pi) % (2 * np.pi) - np.pi
    return np.stack([times, wrapped * unit], axis=1), heading


@pytest.mark.parametrize(
    ("header", "unit", "options"),
    [
        ("time,phi", 1.0, {}),  # guessed from its jumps
        ("time,phi", 180 / np.pi, {}),
        ("time,phi", 1.0, {"circular": ["phi"]}),
        ("time,yaw_deg", 180 / np.pi, {}),
        ("time,phi", 180 / np.pi, {"circular": ["phi"], "units": {"phi": "deg"}}),
    ],
)
def test_a_wrapped_heading_is_not_interpolated_across_its_jump(
    header: str, unit: float, options: dict, tmp_path: Path
) -> None:
    rows, heading = turning_robot(unit)
    demos = load(tmp_path, header, rows, **options)
    assert demos.info.circular_columns == (0,) and demos.info.units == ("rad",)
    # the heading rises by 0.5 rad/s; it ends in (-pi, pi], and the last time is kept
    wanted = heading[-1] - 0.5 * (demos.times[-1] - demos.times)
    error = demos.states[:, 0] - wanted
    np.testing.assert_allclose(error, error[0], atol=1e-12)
    assert -np.pi < demos.states[-1, 0] <= np.pi


def test_linear_keeps_jumps_and_a_switch_is_no_angle(tmp_path: Path) -> None:
    rows, _ = turning_robot(1.0)
    assert load(tmp_path, "time,phi", rows, linear=["phi"]).info.circular_columns == ()
    switch = np.stack([np.arange(20.0), np.where(np.arange(20) % 7 < 3, -3.0, 3.0)], axis=1)
    assert "state" in table(tmp_path, "time,gripper", switch)["gripper"]


def test_an_angle_is_declared_without_a_model(tmp_path: Path) -> None:
    rows = np.array([[e, 0.1 * i, i, -3 + 0.01 * i] for e in range(4) for i in range(20)])
    demos = load(tmp_path, "episode,time,x,phi", rows, circular=["phi"])
    assert demos.info.circular_columns == (1,) and demos.info.units == ("", "rad")
    np.testing.assert_array_equal(demos.states, rows[:, 2:])


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
@pytest.mark.parametrize("named", [True, False])
def test_quaternions_are_stored_in_one_order_and_interpolated_as_rotations(
    order: str, named: bool, tmp_path: Path
) -> None:
    times = np.cumsum(np.random.default_rng(0).uniform(0.2, 0.8, 30))
    axis = np.array([0.6, 0.0, 0.8])
    q = exp(2.0 * times[:, None] * axis)  # 2 rad/s about one axis
    q[10:20] *= -1  # the same rotations
    columns = q[:, ["wxyz".index(axis) for axis in order]]
    header = ",".join(["time", "x", *(f"{'quat_' if named else 'n'}{axis}" for axis in order)])
    options = {} if named else {"quaternions": [f"n{order[0]}:n{order[-1]}:{order}"]}
    rows = np.column_stack([times, times, columns])
    demos = load(tmp_path, header, rows, **options)
    assert demos.info.quaternion_columns == (1,)
    assert [name[-1] for name in demos.info.names] == ["x", "w", "x", "y", "z"]
    instants = times[-1] - (demos.times[-1] - demos.times)
    wanted = exp(2.0 * instants[:, None] * axis)
    found = demos.states[:, 1:]
    np.testing.assert_allclose(np.abs((found * wanted).sum(axis=1)), 1.0, atol=1e-12)
    assert ((found[1:] * found[:-1]).sum(axis=1) > 0).all()
    rows[3, 2:] = 0.0
    with pytest.raises(UsageError, match="are not unit quaternions: their length is between 0 and 1"):
        load(tmp_path, header, rows, quaternions=[f"{header.split(',')[2]}:{header.split(',')[-1]}:{order}"])


def test_constant_and_locked_columns_are_pointed_out(tmp_path: Path) -> None:
    rows = np.array([[e, 0.1 * i, 7, e, (e + i) % 3] for e in range(3) for i in range(5)])
    found = table(tmp_path, "episode,time,a,b,c", rows)
    assert "constant; --drop a?" in found["a"] and "constant in each demonstration" in found["b"]
    assert found["c"] == "state 0 to 2"


@pytest.mark.parametrize(
    ("case", "wanted"),
    [("02-wrapped-heading-resampled", "headings the robot never had: 0"), ("13-semicolon-csv", "semicolons")],
)
def test_the_reported_inputs(case: str, wanted: str) -> None:
    script = CASES / case / "repro.py"
    if not script.exists():
        pytest.skip("the reported inputs are not beside this checkout")
    if "pandas" in script.read_text():
        pytest.importorskip("pandas")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert wanted in done.stdout, done.stderr
