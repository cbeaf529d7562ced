"""NPZ archives of other programs: arrays with any names, one or several demonstrations."""

from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError
from tests.conftest import RELEASED
from tests.demos.archives import archive

T = 5
TIME = 0.1 * np.arange(T)
Q = np.arange(2.0 * T).reshape(T, 2)


def load(tmp_path: Path, *archives: dict[str, np.ndarray], **options) -> Demos:
    folder = tmp_path / "in"
    folder.mkdir(exist_ok=True)
    for i, arrays in enumerate(archives):
        np.savez(folder / f"episode_{i}.npz", **arrays)
    import_demos([str(folder)], tmp_path / "out", None, ImportOptions(**options))
    return load_demos(tmp_path / "out")


def test_one_archive_per_demonstration(tmp_path: Path, capsys) -> None:
    archives = [{"t": TIME, "q": Q + i, "dq": -Q, "u": np.full((T, 1), i)} for i in range(11)]
    demos = load(tmp_path, *archives)
    assert demos.info.names == ("q[0]", "q[1]", "dq[0]", "dq[1]")
    assert demos.info.num_controls == 1
    for i in range(11):  # episode_10 comes after episode_9
        episode = demos.episode(i)
        assert np.array_equal(episode.states, np.column_stack([Q + i, -Q]))
        assert (episode.controls == i).all() and np.array_equal(episode.times, TIME)
    assert capsys.readouterr().err == ""


def test_controls_may_have_one_row_less(tmp_path: Path) -> None:
    demos = load(tmp_path, {"time": TIME, "q": Q, "action": Q[:-1]})
    assert np.array_equal(demos.controls, Q[:-1])


def test_numbers_are_chosen_by_array_and_index(tmp_path: Path) -> None:
    arrays = {"clock": TIME, "q": Q, "grip": Q[:, 0], "tau": Q}
    states, controls = {"x": "q[1]", "g": "grip"}, {"push": "tau[0]"}
    demos = load(tmp_path, arrays, states=states, controls=controls, time="clock")
    assert demos.info.names == ("x", "g")
    assert np.array_equal(demos.states, Q[:, [1, 0]])
    assert np.array_equal(demos.controls[:, 0], Q[:-1, 0])


ENDS = np.array([0, 0, 1, 0, 0], dtype=bool)


@pytest.mark.parametrize(
    ("bounds", "lengths"),
    [
        ({"offsets": np.array([0, 2, 5])}, [2, 3]),
        ({"episode_ends": np.array([2, 5])}, [2, 3]),
        ({"terminals": ENDS}, [3, 2]),
        ({"dones": ENDS.astype(float)[:, None]}, [3, 2]),
        ({"timeouts": ENDS, "terminals": np.array([0, 0, 0, 0, 1])}, [3, 2]),
        ({"episode": np.array([7, 7, 8, 8, 8])}, [2, 3]),
    ],
)
def test_several_demonstrations_in_one_archive(bounds: dict, lengths: list[int], tmp_path: Path) -> None:
    demos = load(tmp_path, {"q": Q, "actions": Q, "rewards": Q[:, 0], **bounds}, dt=0.1)
    assert np.diff(demos.offsets).tolist() == lengths
    assert demos.info.names == ("q[0]", "q[1]")
    assert np.array_equal(demos.states, Q)
    assert np.array_equal(demos.times, 0.1 * np.concatenate([np.arange(n) for n in lengths]))


@pytest.mark.parametrize("num_actions", [T, T - 1])
def test_the_first_axis_may_be_the_demonstration(num_actions: int, tmp_path: Path) -> None:
    q = np.arange(3.0 * T * 2).reshape(3, T, 2)
    arrays = {"q": q, "time": np.tile(TIME, (3, 1)), "action": q[:, :num_actions]}
    demos = load(tmp_path, arrays)
    assert np.diff(demos.offsets).tolist() == [T] * 3
    assert np.array_equal(demos.states, q.reshape(-1, 2))
    assert np.array_equal(demos.controls, q[:, :-1].reshape(-1, 2))


def test_other_arrays_are_left_out_and_listed(tmp_path: Path, capsys) -> None:
    arrays = {
        "time": TIME,
        "q": Q,
        "image": np.zeros((T, 4, 4, 3), np.uint8),
        "start": np.zeros(3),
        "name": np.array("me"),
        "config": np.array({"a": 1}, dtype=object),
    }
    demos = load(tmp_path, arrays)
    assert demos.info.names == ("q[0]", "q[1]")
    left = "image [5, 4, 4, 3], start [3], name [] (not numbers), config [] (not numbers)"
    assert f"episode_0.npz, left out: {left}." in capsys.readouterr().err


def test_the_actions_of_exorl_led_to_the_state_in_their_row(tmp_path: Path, capsys) -> None:
    arrays = {"observation": Q, "action": Q, "reward": Q[:, :1], "discount": np.ones((T, 1))}
    demos = load(tmp_path, arrays, dt=0.02)
    assert np.array_equal(demos.controls, Q[1:])
    assert demos.info.names == ("observation[0]", "observation[1]")
    assert "the action of a row is the one that led to its state, as in ExORL" in capsys.readouterr().err


def test_options_rename_the_states_of_an_archive_by_planspace(tmp_path: Path) -> None:
    arrays = archive(2)
    demos = load(tmp_path, arrays, states={"x": "states[0]", "v": "states[2]"})
    assert demos.info.names == ("x", "v")
    assert np.array_equal(demos.states, arrays["states"][:, [0, 2]])
    assert len(demos) == 2


def test_archives_by_planspace_are_joined(tmp_path: Path) -> None:
    demos = load(tmp_path, archive(2), archive(3))
    assert len(demos) == 5
    assert demos.indices.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"q": Q}, r"has no column with the name of a time; its columns are q\[0\], q\[1\]. Give --time"),
        (
            {"time": TIME, "q": Q, "offsets": np.array([0, 4])},
            "'offsets' ends at 4, but no array has this many",
        ),
        ({"time": TIME, "q": Q, "offsets": np.array([1, 5])}, "'offsets' must rise to the number of rows"),
        ({"time": TIME, "q": Q, "offsets": np.array([0, 3, 2, 5])}, "'offsets' must rise"),
        (
            {"time": TIME, "q": Q, "offsets": np.array([0.0, 5.0])},
            "'offsets' must contain numbers, got type f",
        ),
        (
            {"time": TIME, "q": Q, "actions": Q[:2]},
            "'actions' has 2 rows; expected 5, or 4 without the last of each demonstration",
        ),
        ({"time": TIME[:3], "q": Q}, "'time' has 3 rows; expected 5."),
        ({"time": TIME, "q": Q, "qpos": Q.astype(object)}, "'qpos' does not hold numbers"),
        ({"time": TIME, "q": Q, "u": Q[None, None]}, r"'u' has the shape \[1, 1, 5, 2\]; expected 2 axes"),
        ({"time": TIME, "q": Q, "episode_ends": np.array([0, 5])}, "demonstration 0 has no states"),
        ({"name": np.array("me")}, r"has no array with rows of numbers; it has name \[\] \(not numbers\)"),
        ({"time": TIME, "q": np.where(Q == 3, np.nan, Q)}, r"row 1: column 'q\[1\]' is empty"),
    ],
)
def test_what_does_not_fit_is_refused(arrays: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, arrays)
    assert not (tmp_path / "out").exists()


def test_archives_with_other_arrays_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        PlanspaceError, match=r"episode_1\.npz has the states \(q, time2\)|all files of a dataset"
    ):
        load(tmp_path, {"time": TIME, "q": Q}, {"time": TIME, "p": Q})


def test_the_door_of_adroit(tmp_path: Path) -> None:
    file = RELEASED.parent / "adroit-door-human" / "door_human.npz"
    if not file.exists():
        pytest.skip("the recordings are not here")
    import_demos([str(file)], tmp_path / "out", None, ImportOptions(dt=0.01))
    demos = load_demos(tmp_path / "out")
    with np.load(file) as arrays:
        assert np.array_equal(demos.states, arrays["observations"].astype(float))
        assert np.array_equal(demos.offsets, arrays["offsets"])
    assert (len(demos), demos.info.num_controls) == (25, 28)
    assert demos.info.names[::38] == ("observations[0]", "observations[38]")
