"""NPZ archives with the states of MuJoCo and dm_control."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from planspace.cli.entry import main
from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos
from planspace.demos.describe import validate
from planspace.demos.formats.recorded_model import model_states
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError
from planspace.plan.demonstrations import state_info
from planspace.tasks.problem_file import load_problem

MODEL = """<mujoco><option timestep="0.01"/><worldbody>
<body><geom size=".1" mass="1"/><joint name="turn" axis="0 1 0"/>
  <body pos="0 0 .3"><geom size=".1" mass="1"/><joint name="lift" type="slide" axis="1 0 0"/></body></body>
<body name="cube" pos="1 0 0"><geom size=".1" mass="1"/><freejoint name="cube"/></body>
</worldbody><actuator>
<general name="push" joint="lift" dyntype="filter" dynprm="0.1" ctrlrange="-1 1" ctrllimited="true"/>
<motor joint="turn"/></actuator></mujoco>"""
NAMES = ("turn", "lift", "cube_x", "cube_qw", "turnvel", "cube_rxvel", "act_push")


def rollout(length: int = 30, seed: int = 0) -> dict[str, np.ndarray]:
    """A simulation of `MODEL`; the control in a row is held from its state on."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data, random = mujoco.MjData(model), np.random.default_rng(seed)
    rows = []
    for control in random.uniform(-1, 1, (length, model.nu)):
        data.ctrl[:] = control
        rows.append((data.time, *map(np.copy, (data.qpos, data.qvel, data.act, data.ctrl))))
        mujoco.mj_step(model, data)
    return dict(
        zip(("time", "qpos", "qvel", "act", "ctrl"), map(np.array, zip(*rows, strict=True)), strict=True)
    )


def whole(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """The states as dm_control's `get_state` returns them."""
    return np.concatenate([arrays["qpos"], arrays["qvel"], arrays["act"]], axis=1)


@pytest.fixture
def model(tmp_path: Path) -> StateInfo:
    (tmp_path / "robot.xml").write_text(MODEL)
    return model_states(tmp_path / "robot.xml")


def load(tmp_path: Path, info: StateInfo | None, *archives: dict[str, np.ndarray], **options) -> Demos:
    for i, arrays in enumerate(archives):
        np.savez(tmp_path / f"{i}.npz", **arrays)
    sources = [str(tmp_path / f"{i}.npz") for i in range(len(archives))]
    import_demos(sources, tmp_path / "out", info, ImportOptions(**options))
    return load_demos(tmp_path / "out")


def test_a_model_gives_names_units_angles_and_the_model(tmp_path: Path, model: StateInfo) -> None:
    arrays = rollout()
    demos = load(tmp_path, model, arrays, rollout(seed=1))
    assert set(NAMES) <= set(demos.info.names)
    assert demos.info.circular_columns == (demos.info.names.index("turn"),)
    assert np.array_equal(demos.episode(0).states, whole(arrays))
    assert np.array_equal(demos.episode(0).controls, arrays["ctrl"][:-1])
    assert len(demos) == 2
    assert validate(tmp_path / "out", replay_controls=True)["replay_error"] < 1e-6


@pytest.mark.parametrize("key", ["physics", "state"])
@pytest.mark.parametrize("has_time", [True, False])
def test_states_in_one_array(key: str, has_time: bool, tmp_path: Path, model: StateInfo) -> None:
    arrays = rollout()
    states = np.column_stack([arrays["time"], whole(arrays)]) if has_time else whole(arrays)
    demos = load(tmp_path, model, {key: states, "action": arrays["ctrl"]}, dt=None if has_time else 0.01)
    assert np.array_equal(demos.states, whole(arrays))
    np.testing.assert_allclose(demos.times, arrays["time"], atol=1e-12)


def test_rollouts_of_mujoco_have_an_axis_for_demonstrations(tmp_path: Path, model: StateInfo) -> None:
    runs = [rollout(seed=i) for i in range(3)]
    states = np.stack([np.column_stack([run["time"], whole(run)]) for run in runs])
    demos = load(tmp_path, model, {"state": states, "control": np.stack([run["ctrl"] for run in runs])})
    assert len(demos) == 3
    assert np.array_equal(demos.episode(2).states, whole(runs[2]))


def test_the_problem_chooses_its_joints(tmp_path: Path) -> None:
    problem = state_info(load_problem("cartpole-swingup"))
    qpos, qvel, time = np.arange(12.0).reshape(6, 2) / 10, np.ones((6, 2)), 0.04 * np.arange(6)
    demos = load(tmp_path, problem, {"qpos": qpos, "qvel": qvel, "time": time, "actions": qpos[:, :1]})
    assert demos.info.plain() == problem.plain()
    assert np.array_equal(demos.states, np.concatenate([qpos, qvel], axis=1))


def test_without_a_model_positions_and_velocities_are_numbered(tmp_path: Path, capsys) -> None:
    arrays = rollout()
    demos = load(tmp_path, None, {key: arrays[key] for key in ("qpos", "qvel")}, dt=0.01)
    assert demos.info.names == (*(f"qpos{i}" for i in range(9)), *(f"qvel{i}" for i in range(8)))
    assert "has no controls" in capsys.readouterr().err


def test_dm_controls_state_needs_a_model(tmp_path: Path, capsys) -> None:
    arrays = rollout()
    load(tmp_path, None, {"physics": whole(arrays), "observation": arrays["qpos"]}, dt=0.01)
    assert "give --model FILE.xml or --problem" in capsys.readouterr().err


def test_actions_of_another_controller_are_kept(tmp_path: Path, model: StateInfo) -> None:
    arrays = rollout()
    demos = load(tmp_path, model, {**arrays, "ctrl": np.ones((30, 5))})
    assert demos.info.num_controls == 5
    problem = state_info(load_problem("cartpole-swingup"))
    states = {"qpos": np.zeros((6, 2)), "qvel": np.ones((6, 2)), "actions": np.ones((6, 3))}
    with pytest.raises(
        PlanspaceError, match="'actions' has 3 numbers, but 'cartpole-swingup' has 1 controls"
    ):
        load(tmp_path, problem, states, dt=0.04)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": None}, "has no array with the time of each state .*give --dt SECONDS"),
        ({"qpos": np.zeros((30, 8))}, "'qpos' has 8 numbers, but the model has 9; give the model that"),
        ({"act": None}, "'act' has 0 numbers, but the model has 1"),
        ({"time": np.zeros(30)}, "row 1: the time 0 does not come after 0"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict, message: str, tmp_path: Path, model: StateInfo) -> None:
    arrays = {key: array for key, array in {**rollout(), **change}.items() if array is not None}
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, model, arrays)
    assert not (tmp_path / "out").exists()


def test_archives_that_differ_are_refused(tmp_path: Path) -> None:
    arrays = rollout()
    other = {**arrays, "qpos": arrays["qpos"][:, :-1]}
    with pytest.raises(PlanspaceError, match=r"1\.npz has 17 numbers per state and 2 per control, but .* 18"):
        load(tmp_path, None, arrays, other)


def test_the_command_takes_a_model(tmp_path: Path, capsys) -> None:
    (tmp_path / "robot.xml").write_text(MODEL)
    np.savez(tmp_path / "a.npz", **rollout())
    source, out = str(tmp_path / "a.npz"), str(tmp_path / "out")
    main(["demos", "import", source, "--model", str(tmp_path / "robot.xml"), "--out", out])
    assert load_demos(out).info.names[:2] == ("turn", "lift")
    assert main(["demos", "import", source, "--model", "a.xml", "--problem", "pendulum", "--out", out]) == 2
    assert "--problem has a model already; leave --model out" in capsys.readouterr().err
