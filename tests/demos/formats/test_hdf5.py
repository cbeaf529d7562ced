"""HDF5 files in the layouts of robomimic, robosuite and D4RL."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_demos, import_demos
from planspace.demos.dataset import Demos
from planspace.demos.describe import validate
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from tests.conftest import RELEASED

h5py = pytest.importorskip("h5py")

MODEL = """<mujoco><worldbody>
<body name="base"><geom size=".1" mass="1"/><joint name="turn" axis="0 1 0"/>
  <body><geom {geom} mass="1"/><joint name="limited" axis="1 0 0" range="-1 1"/></body></body>
<body name="cube"><geom size=".1" mass="1"/><freejoint name="cube_joint0"/></body>
</worldbody><actuator><motor joint="turn"/><motor joint="limited"/></actuator></mujoco>"""
WHOLE, MESH = (
    MODEL.format(geom='size=".1"'),
    MODEL.format(geom='type="mesh" mesh="hand"').replace(
        "<worldbody>", '<asset><mesh name="hand" file="/home/someone/hand.stl"/></asset><worldbody>'
    ),
)
NAMES = ("turn", "limited", *(f"cube_joint0_{part}" for part in ("x", "y", "z", "qw", "qx")))


def rows(num: int = 4) -> np.ndarray:
    """States [time, qpos, qvel] of `MODEL`."""
    states = np.random.default_rng(0).uniform(-1, 1, (num, 18))
    states[:, 6:10] = [1, 0, 0, 0]
    states[:, 0] = 3 + 0.05 * np.arange(num)
    return states


def write(file: Path, model: str = WHOLE, num_demos: int = 3, **arrays: np.ndarray) -> None:
    """A file as robomimic writes them."""
    content = {"states": rows(), "actions": np.ones((4, 2)), **arrays}
    with h5py.File(file, "w") as opened:
        data = opened.create_group("data")
        data.attrs["env_args"] = json.dumps(
            {"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 20, "robots": ["Panda"]}}
        )
        for i in (10, 2, 1)[:num_demos]:  # HDF5 sorts by text
            demo = data.create_group(f"demo_{i}")
            demo.attrs["model_file"], demo.attrs["num_samples"] = model, 4
            for key, array in content.items():
                demo.create_dataset(key, data=array, compression="gzip", shuffle=True, fletcher32=True)
            demo["actions"][0] = i
            demo.create_dataset("obs/eef_pos", data=np.arange(12.0).reshape(4, 3))
            demo.create_dataset("obs/image", data=np.zeros((4, 2, 2, 3), np.uint8))
        opened["mask/train"] = np.array([b"demo_1", b"demo_10"])


def load(tmp_path: Path, name: str = "a.hdf5", info: StateInfo | None = None, **options) -> Demos:
    shutil.rmtree(tmp_path / "out", ignore_errors=True)
    import_demos([str(tmp_path / name)], tmp_path / "out", info, ImportOptions(**options))
    return load_demos(tmp_path / "out")


# --- robomimic --------------------------------------------------------------------------------------


def test_states_are_named_by_the_joints_of_the_model(tmp_path: Path, capsys) -> None:
    write(tmp_path / "a.hdf5")
    demos = load(tmp_path, as_recorded=True)
    assert capsys.readouterr().err == ""
    assert demos.info.names[:7] == NAMES
    assert demos.info.names[9:12] == ("turnvel", "limitedvel", "cube_joint0_xvel")
    assert (demos.info.circular_columns, demos.info.quaternion_columns) == ((0,), (5,))
    assert demos.info.joints == ("turn", "limited", "cube_joint0")
    assert demos.controls[::3, 0].tolist() == [1, 2, 10]  # in the order of the numbers
    np.testing.assert_array_equal(demos.states[:4], rows()[:, 1:])
    np.testing.assert_allclose(demos.times[:4], [0, 0.05, 0.1, 0.15])


def test_a_model_without_its_meshes_names_the_states(tmp_path: Path, capsys) -> None:
    write(tmp_path / "a.hdf5", MESH)
    demos = load(tmp_path)
    assert capsys.readouterr().err == (
        "the dataset has no model: it refers to files that were not recorded, such as "
        "'/home/someone/hand.stl'.\n"
    )
    assert demos.info.names[:7] == NAMES
    assert (demos.info.circular_columns, demos.info.quaternion_columns) == ((0,), (5,))
    assert demos.info.source is None


def test_a_model_is_read_from_a_file_next_to_the_recording(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5", "model_1.xml")
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "model_1.xml").write_text(WHOLE)
    assert load(tmp_path).info.joints == ("turn", "limited", "cube_joint0")


def test_joints_of_different_models_are_compared(tmp_path: Path, capsys) -> None:
    for other, message in (
        (
            WHOLE.replace("mass", " mass"),
            "the dataset has no model: the demonstrations have different models.\n",
        ),
        (WHOLE.replace("turn", "roll"), "the models of the demonstrations have different joints.\n"),
    ):
        write(tmp_path / "a.hdf5")
        with h5py.File(tmp_path / "a.hdf5", "a") as opened:
            opened["data/demo_2"].attrs["model_file"] = other
        import_demos([str(tmp_path / "a.hdf5")], tmp_path / str(len(other)), None, ImportOptions())
        assert capsys.readouterr().err.endswith(message)


def test_without_a_model_the_states_are_numbered(tmp_path: Path, capsys) -> None:
    write(tmp_path / "a.hdf5", "")
    with h5py.File(tmp_path / "a.hdf5", "a") as opened:
        opened["data"].attrs["env_args"] = json.dumps({"env_name": "Mine", "type": 1, "env_kwargs": {}})
    demos = load(tmp_path)
    assert demos.info.names == tuple(f"state{i}" for i in range(17))
    assert "the states are named state0, state1, ...: the file does not say which" in capsys.readouterr().err
    np.testing.assert_array_equal(demos.states[:4], rows()[:, 1:])


def test_times_that_do_not_increase_are_replaced_by_the_control_frequency(tmp_path: Path) -> None:
    states = rows()
    states[:, 0] = 0
    write(tmp_path / "a.hdf5", states=states)
    np.testing.assert_allclose(load(tmp_path).times[:4], [0, 0.05, 0.1, 0.15])
    with h5py.File(tmp_path / "a.hdf5", "a") as opened:
        del opened["data"].attrs["env_args"]
    with pytest.raises(PlanspaceError, match=r"demo_1, row 1: the time 0 does not come after 0"):
        load(tmp_path)
    assert load(tmp_path, dt=0.1).times[1] == 0.1


def test_states_are_chosen_among_observations_and_joints(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5")
    demos = load(tmp_path, states={"x": "eef_pos[0]", "angle": "turn", "y": "states[1]", "z": "2"})
    assert demos.info.names == ("x", "angle", "y", "z")
    assert (demos.info.units, demos.info.circular_columns) == (("", "rad", "", ""), (1,))
    np.testing.assert_array_equal(demos.states[:4], np.column_stack([[0, 3, 6, 9], rows()[:, 1:4]]))
    with pytest.raises(UsageError, match=r"no key 'eef'; the keys are: cube_joint0.*eef_pos, image"):
        load(tmp_path, states={"x": "eef"})
    with pytest.raises(PlanspaceError, match=r"must be vectors of numbers, got float64 of shape \(2, 2, 3\)"):
        load(tmp_path, states={"x": "image[0]"})


def test_states_of_a_problem_are_chosen_by_name(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5")
    demos = load(tmp_path, info=StateInfo(("limited", "turn"), ("rad", "rad"), (1,), 2, problem="mine"))
    np.testing.assert_array_equal(demos.states[:4], rows()[:, [2, 1]])


def test_a_filter_key_selects_demonstrations(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5")
    assert load(tmp_path, filter_key="train").controls[::3, 0].tolist() == [1, 10]
    with pytest.raises(UsageError, match="unknown filter key 'trian'. Did you mean 'train'?"):
        load(tmp_path, filter_key="trian")


def test_controls_that_are_no_actuators_cannot_be_replayed(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5", actions=np.ones((4, 7)))
    load(tmp_path)
    with pytest.raises(PlanspaceError, match="have 7 numbers, but the model has 2 actuators"):
        validate(tmp_path / "out", replay_controls=True)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"actions": np.ones((2, 2))}, r"demo_1 has 4 states and 2 actions"),
        ({"states": rows()[:1], "actions": np.ones((1, 2))}, "demo_1 has 1 states; at least two"),
        ({"states": np.full((4, 18), np.nan)}, "not finite"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(arrays: dict, message: str, tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5", **arrays)
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path)
    assert not (tmp_path / "out").exists()


# --- export -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["hdf5", "h5"])
def test_export_and_import_give_the_same_demonstrations(suffix: str, demos: Demos, tmp_path: Path) -> None:
    assert export_demos(demos, str(tmp_path / f"a.{suffix}")) == tmp_path / f"a.{suffix}"
    back = load(tmp_path, f"a.{suffix}")
    assert back.hash == demos.hash
    assert back.info == demos.info
    for name in ("states", "controls", "times", "goals", "success", "indices", "seeds", "costs"):
        np.testing.assert_array_equal(getattr(back, name), getattr(demos, name))


def test_robomimic_finds_its_arrays_in_an_export(demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, str(tmp_path / "a.hdf5"))
    with h5py.File(tmp_path / "a.hdf5") as opened:
        demo = opened["data/demo_0"]
        num = demo.attrs["num_samples"]
        assert all(len(demo[key]) == num for key in ("states", "actions", "rewards", "dones", "obs/state"))
        assert opened["data"].attrs["total"] == len(demos.states)
        assert demo.attrs["model_file"] == demos.info.source.text


def test_demonstrations_without_controls_are_exported(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5", actions=np.ones((4, 0)))
    with h5py.File(tmp_path / "a.hdf5", "w") as opened:
        opened["observations"], opened["actions"] = np.eye(4), np.zeros((4, 0))
        opened["timeouts"] = np.zeros(4, dtype=bool)
    first = load(tmp_path)
    export_demos(first, str(tmp_path / "b.hdf5"))
    import_demos([str(tmp_path / "b.hdf5")], tmp_path / "again", None, ImportOptions())
    assert load_demos(tmp_path / "again").hash == first.hash


# --- D4RL -------------------------------------------------------------------------------------------


def write_d4rl(file: Path, **arrays: np.ndarray | None) -> None:
    content = {
        "observations": np.arange(24.0, dtype=np.float32).reshape(8, 3),
        "actions": np.arange(8.0)[:, None],
        "rewards": np.zeros(8),
        "terminals": np.array([0, 0, 1, 0, 0, 0, 0, 0], dtype=bool),
        "timeouts": np.array([0, 0, 0, 1, 0, 0, 0, 0], dtype=bool),
        "infos/qpos": np.arange(16.0).reshape(8, 2),
        "infos/qvel": np.arange(8.0).reshape(8, 1),
        **arrays,
    }
    with h5py.File(file, "w") as opened:
        for key, array in content.items():
            if array is not None:
                opened[key] = array
        opened["metadata/algorithm"] = "SAC"


def test_episodes_are_cut_at_terminals_and_timeouts(tmp_path: Path, capsys) -> None:
    write_d4rl(tmp_path / "a.hdf5")
    demos = load(tmp_path)
    assert capsys.readouterr().err == (
        "the file does not record its time step: 1 s is assumed; --dt SECONDS sets it.\n"
        "1 of 3 episodes have one state: left out.\n"
    )
    assert demos.info.names == ("qpos0", "qpos1", "qvel0")
    assert demos.offsets.tolist() == [0, 3, 7]
    assert demos.states[:, 2].tolist() == [0, 1, 2, 4, 5, 6, 7]
    assert demos.controls[:, 0].tolist() == [0, 1, 4, 5, 6]


def test_without_qpos_the_observations_are_the_states(tmp_path: Path) -> None:
    write_d4rl(tmp_path / "a.h5", **{"infos/qvel": None, "timeouts": None})
    demos = load(tmp_path, "a.h5", dt=0.5)
    assert demos.info.names == ("state0", "state1", "state2")
    assert demos.offsets.tolist() == [0, 3, 8]
    assert demos.times.tolist() == [0, 0.5, 1, 0, 0.5, 1, 1.5, 2]
    np.testing.assert_array_equal(demos.states, np.arange(24.0).reshape(8, 3))


def test_d4rl_states_are_chosen_by_array_and_index(tmp_path: Path) -> None:
    write_d4rl(tmp_path / "a.hdf5")
    demos = load(tmp_path, states={"a": "2", "b": "infos/qpos[1]", "c": "observations[0]"})
    assert demos.states[0].tolist() == [2, 1, 0]
    with pytest.raises(UsageError, match="no key 'infos/acc'"):
        load(tmp_path, states={"a": "infos/acc[1]"})


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"terminals": None, "timeouts": None}, "neither terminals nor timeouts"),
        ({"actions": np.zeros((7, 1))}, "actions has 7 rows, but observations has 8"),
        ({"terminals": np.zeros((8, 2))}, r"terminals has the shape \(8, 2\); expected \(8,\)"),
    ],
)
def test_d4rl_arrays_that_do_not_fit_are_refused(arrays: dict, message: str, tmp_path: Path) -> None:
    write_d4rl(tmp_path / "a.hdf5", **arrays)
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path)


# --- both -------------------------------------------------------------------------------------------


def test_another_layout_is_refused_with_what_it_contains(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.hdf5", "w") as opened:
        opened["episode_0/observations"] = np.eye(3)
        opened["episode_1/observations"] = np.eye(3)
    with pytest.raises(PlanspaceError) as caught:
        load(tmp_path)
    message = str(caught.value)
    assert "a.hdf5 has an unknown layout: it contains 'episode_0', 'episode_1'. Known: robomimic" in message
    assert "\n" not in message


def test_files_of_two_layouts_are_not_mixed(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5")
    write_d4rl(tmp_path / "b.hdf5")
    with pytest.raises(PlanspaceError, match="D4RL and robomimic files; import one layout at a time"):
        import_demos([str(tmp_path)], tmp_path / "out", None, ImportOptions())


def test_several_robomimic_files_make_one_dataset(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5")
    write(tmp_path / "b.hdf5", num_demos=1)
    import_demos([str(tmp_path)], tmp_path / "out", None, ImportOptions())
    demos = load_demos(tmp_path / "out")
    assert demos.indices.tolist() == [0, 1, 2, 3]


# --- robosuite's recordings -------------------------------------------------------------------------


@pytest.fixture
def robosuite() -> Path:
    """Recordings that come with robosuite 1.0; a developer has them beside the checkout, a user does not."""
    folder = RELEASED.parent / "robosuite-human"
    if not folder.exists():
        pytest.skip("robosuite's recordings are not beside this checkout")
    return folder


@pytest.mark.parametrize(
    ("name", "shape", "quaternions", "controls", "last"),
    [
        ("door", (261, 22), (), 7, "latch_jointvel"),
        ("lift", (412, 31), (12,), 7, "cube_jnt0_rzvel"),
        ("nut-assembly", (1036, 44), (12, 19), 7, "RoundNut0_jnt0_rzvel"),
        ("stack", (532, 44), (12, 19), 7, "cubeB_jnt0_rzvel"),
        ("wipe", (174, 14), (), 6, "robot0_joint7vel"),
    ],
)
def test_recordings_of_robosuite(
    name: str, shape: tuple, quaternions: tuple, controls: int, last: str, tmp_path: Path, robosuite: Path
) -> None:
    import_demos([str(robosuite / f"{name}.hdf5")], tmp_path / "out", None, ImportOptions())
    demos = load_demos(tmp_path / "out")
    assert demos.states.shape == shape
    assert demos.info.names[0] == "robot0_joint1"
    assert demos.info.names[-1] == last
    assert demos.info.num_controls == controls
    assert demos.info.quaternion_columns == quaternions
    np.testing.assert_allclose(np.diff(demos.times), 0.05)
    for first in quaternions:
        np.testing.assert_allclose(np.linalg.norm(demos.states[:, first : first + 4], axis=1), 1, atol=1e-9)
