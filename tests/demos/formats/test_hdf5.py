"""HDF5 files in the layouts of robomimic, robosuite and D4RL."""

import json
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_demos, import_demos
from planspace.demos.dataset import Demos
from planspace.demos.describe import validate
from planspace.demos.formats.robomimic import read_robomimic
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from tests.conftest import RELEASED

from .hdf5_files import MESH, WHOLE, load, rows, write, write_d4rl

h5py = pytest.importorskip("h5py")

NAMES = ("turn", "limited", *(f"cube_joint0_{part}" for part in ("x", "y", "z", "qw", "qx")))


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


def test_a_demonstration_without_states_is_named(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5")
    with h5py.File(tmp_path / "a.hdf5", "a") as opened:
        del opened["data/demo_10/states"]
    for states in ({}, {"x": "eef_pos[0]"}):
        with pytest.raises(PlanspaceError, match="a.hdf5, demo_10 has no array 'states'"):
            load(tmp_path, states=states)
        with h5py.File(tmp_path / "a.hdf5", "a") as opened:
            opened["data"].attrs["env_args"] = "{"


def test_without_states_observations_must_be_chosen(tmp_path: Path, capsys) -> None:
    write(tmp_path / "a.hdf5")
    with h5py.File(tmp_path / "a.hdf5", "a") as opened:
        for i in (1, 2, 10):
            del opened[f"data/demo_{i}/states"]
    with pytest.raises(UsageError, match="has no array 'states'; choose the states with --state"):
        load(tmp_path)
    demos = load(tmp_path, states={"x": "eef_pos[0]"})
    assert demos.states[:4, 0].tolist() == [0, 3, 6, 9]
    np.testing.assert_allclose(demos.times[:4], [0, 0.05, 0.1, 0.15])  # from the control frequency


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


def test_an_export_is_imported_for_a_problem_with_some_of_its_states(demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, str(tmp_path / "a.hdf5"))
    names = demos.info.names[1::-1]
    some = demos.select(names)
    back = load(tmp_path, info=some.info)
    np.testing.assert_array_equal(back.states, some.states)
    np.testing.assert_array_equal(back.goals, some.goals)
    with pytest.raises(UsageError, match="--state and --dt cannot be used with a.hdf5, which planspace"):
        load(tmp_path, dt=0.1)


# --- layouts -------------------------------------------------------------------------------------------


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


def test_lists_of_demonstrations_are_passed_on(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5")
    write(tmp_path / "b.hdf5")
    imported = read_robomimic([str(tmp_path / name) for name in ("a.hdf5", "b.hdf5")], None, ImportOptions())
    assert imported.splits == {"train": [0, 2, 3, 5]}  # demo_1 and demo_10 of three in each file


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
