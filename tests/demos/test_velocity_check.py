"""Positions that do not move as their velocities say, and numbers beyond the limits of the model."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from planspace.demos.convert import import_demos, preview
from planspace.demos.formats.recorded_model import model_states
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import UsageError

MODEL = """<mujoco><option timestep="0.01"/><worldbody>
<body><geom size=".1" mass="1"/><joint name="lift" type="slide" axis="1 0 0" range="-4 4" limited="true"/>
  <body pos="0 0 .3"><geom size=".1" mass="1" pos=".2 0 0"/><joint name="turn" axis="0 1 0"/></body></body>
<body pos="2 0 0"><geom type="box" size=".1 .2 .3" mass="1" pos=".1 0 -.3"/><joint name="ball" type="ball"/>
</body></worldbody>
<actuator><motor name="push" joint="lift" ctrlrange="-5 5" ctrllimited="true"/></actuator></mujoco>"""
Arrays = dict[str, np.ndarray]
ROW = 40
"""Number of states of a demonstration."""


def recording() -> Arrays:
    """Three demonstrations, laid end to end."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    random, rows = np.random.default_rng(0), []
    for _ in range(3):
        data = mujoco.MjData(model)
        data.qpos[:2], data.qvel[:] = random.uniform(-1, 1, 2), random.uniform(-2, 2, model.nv)
        for _ in range(ROW):
            data.ctrl[:] = random.uniform(-5, 5)
            rows.append((data.time, *map(np.copy, (data.qpos, data.qvel, data.ctrl))))
            for _ in range(2):
                mujoco.mj_step(model, data)
    names = ("time", "qpos", "qvel", "ctrl")
    arrays = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))
    return {**arrays, "offsets": np.arange(4) * ROW}


@pytest.fixture
def info(tmp_path: Path) -> StateInfo:
    (tmp_path / "robot.xml").write_text(MODEL)
    return model_states(tmp_path / "robot.xml")


def notices(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], info: StateInfo | None, arrays: Arrays, **options
) -> str:
    np.savez(tmp_path / "a.npz", **arrays)
    preview([str(tmp_path / "a.npz")], info, ImportOptions(**options))
    return capsys.readouterr().err


def in_degrees(arrays: Arrays) -> Arrays:
    qpos = arrays["qpos"].copy()
    qpos[:, 1] = np.degrees(qpos[:, 1])
    return {**arrays, "qpos": qpos}


def with_degrees_per_second(arrays: Arrays) -> Arrays:
    qvel = arrays["qvel"].copy()
    qvel[:, 1] = np.degrees(qvel[:, 1])
    return {**arrays, "qvel": qvel}


def with_joints_in_another_order(arrays: Arrays) -> Arrays:
    return {**arrays, "qpos": arrays["qpos"][:, [1, 0, 2, 3, 4, 5]]}


def with_scalar_last(arrays: Arrays) -> Arrays:
    return {**arrays, "qpos": arrays["qpos"][:, [0, 1, 3, 4, 5, 2]]}


def with_half_the_times(arrays: Arrays) -> Arrays:
    return {**arrays, "time": arrays["time"] / 2}


def as_one_demonstration(arrays: Arrays) -> Arrays:
    return {"time": 0.02 * np.arange(3 * ROW), **{key: arrays[key] for key in ("qpos", "qvel", "ctrl")}}


def with_large_controls(arrays: Arrays) -> Arrays:
    return {**arrays, "ctrl": 10 * arrays["ctrl"]}


@pytest.mark.parametrize("with_model", [True, False])
def test_positions_that_agree_with_velocities_need_no_word(
    with_model: bool, info: StateInfo, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = notices(tmp_path, capsys, info if with_model else None, recording())
    assert "velocities" not in told
    assert "limits" not in told


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (in_degrees, "times as far as their velocities say: turn; if positions are in degrees, give "),
        (with_degrees_per_second, "in degrees per second, give --unit turnvel=deg/s"),
        (with_joints_in_another_order, "lift moves as turnvel says, turn moves as liftvel says"),
        (with_scalar_last, "do not move as their velocities say: ball_qx and ball_rxvel"),
        (with_half_the_times, "is the time step 0.02 s instead of 0.01 s?"),
        (with_large_controls, "controls exceed the limits of their actuators: push from -4"),
    ],
)
def test_what_numbers_probably_mean_is_said(
    change: Callable[[Arrays], Arrays],
    words: str,
    info: StateInfo,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    told = notices(tmp_path, capsys, info, change(recording()))
    assert words in told
    assert len(told.strip().splitlines()) == 1, told


def test_swapped_positions_and_velocities_are_found_without_a_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arrays = recording()
    swapped = {**arrays, "qpos": arrays["qvel"][:, :2], "qvel": arrays["qpos"][:, :2]}
    told = notices(tmp_path, capsys, None, swapped)
    assert "do not move as their velocities say: qpos0 and qvel0, qpos1 and qvel1; are positions and " in told


def test_jumps_where_demonstrations_begin_are_counted(
    info: StateInfo, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = notices(tmp_path, capsys, info, as_one_demonstration(recording()))
    assert "2 jumps of positions" in told
    assert f"demonstration 0, row {ROW}: lift from" in told
    assert "`offsets` or --episode" in told


def test_times_that_dt_replaces_are_named(
    info: StateInfo, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = notices(tmp_path, capsys, info, recording(), dt=0.02)
    assert "--dt is used instead of the times in 'time'" in told


def test_positions_beyond_their_limits_are_named(
    info: StateInfo, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arrays = recording()
    arrays["qpos"][:, 0] += 6.0
    assert "positions exceed the limits of their joints: lift from" in notices(tmp_path, capsys, info, arrays)


def test_an_angle_that_jumps_by_a_turn_agrees_with_its_velocity(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = 0.1 * np.arange(200)
    turn = np.mod(time * 2.0, 2 * np.pi)
    rows = np.column_stack([time, turn, np.full(200, 2.0)])
    (tmp_path / "a.csv").write_text("time,yaw,yaw_vel\n" + "\n".join(",".join(map(str, r)) for r in rows))
    preview([str(tmp_path / "a.csv")], None, ImportOptions())
    assert "velocities" not in capsys.readouterr().err


def test_units_of_a_table_are_converted_to_those_of_the_model(info: StateInfo, tmp_path: Path) -> None:
    arrays = recording()
    names = [f"{name} [deg]" if name == "turn" else name for name in info.names]
    rows = np.column_stack([arrays["time"], in_degrees(arrays)["qpos"], arrays["qvel"], arrays["ctrl"]])[:ROW]
    text = [",".join(["time", *names, "control1"]), *(",".join(map(repr, row)) for row in rows.tolist())]
    (tmp_path / "a.csv").write_text("\n".join(text))
    import_demos([str(tmp_path / "a.csv")], tmp_path / "out", info, ImportOptions(as_recorded=True))
    demos = load_demos(tmp_path / "out")
    assert demos.info.units[:2] == ("m", "rad")
    assert np.allclose(demos.states[:, 1], arrays["qpos"][:ROW, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ({"lift": "cm"}, {"lift": 0.01}),
        ({"turnvel": "rpm"}, {"turnvel": 2 * np.pi / 60}),
        ({"lift": "m"}, {}),
    ],
)
def test_declared_units_are_converted_to_those_of_the_model(
    unit: dict[str, str], factor: dict[str, float], info: StateInfo, tmp_path: Path
) -> None:
    arrays = recording()
    np.savez(tmp_path / "a.npz", **arrays)
    options = ImportOptions(units=unit, as_recorded=True)
    import_demos([str(tmp_path / "a.npz")], tmp_path / "out", info, options)
    states = np.concatenate([arrays["qpos"], arrays["qvel"]], axis=1)
    factors = [factor.get(name, 1.0) for name in info.names]
    found = load_demos(tmp_path / "out")
    assert found.info.units == info.units
    assert np.allclose(found.states[:, :2], (states * factors)[:, :2])
    assert np.allclose(found.states[:, 6:], (states * factors)[:, 6:])


@pytest.mark.parametrize("unit", [{"lift": "furlong"}, {"turn": "m"}, {"turnvel": "deg"}])
def test_units_that_cannot_be_converted_are_refused(
    unit: dict[str, str], info: StateInfo, tmp_path: Path
) -> None:
    np.savez(tmp_path / "a.npz", **recording())
    with pytest.raises(UsageError, match="cannot be converted"):
        import_demos([str(tmp_path / "a.npz")], tmp_path / "out", info, ImportOptions(units=unit))
    assert not (tmp_path / "out").exists()
