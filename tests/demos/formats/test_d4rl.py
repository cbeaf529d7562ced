from pathlib import Path

import numpy as np
import pytest

from planspace.errors import PlanspaceError, UsageError

from .hdf5_files import load, write_d4rl


def test_episodes_are_cut_at_terminals_and_timeouts(tmp_path: Path, capsys) -> None:
    write_d4rl(tmp_path / "a.hdf5")
    demos = load(tmp_path)
    assert capsys.readouterr().err == (
        "the file does not record its time step: 1 s is assumed; `demos import --dt SECONDS` sets it.\n"
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
