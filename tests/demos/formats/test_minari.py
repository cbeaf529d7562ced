import json
import sys
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_demos, import_demos
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from tests.demos.formats.minari_datasets import NAME, boxes, load, make, make_plain


@pytest.mark.parametrize(("storage", "module"), [("hdf5", "h5py"), ("arrow", "pyarrow")])
def test_export_and_import_give_the_same_dataset(
    storage: str, module: str, minari, demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(module)
    monkeypatch.setattr("planspace.demos.formats.minari._storage_format", lambda: storage)
    export_demos(demos, f"minari:{NAME}")
    back = load(tmp_path)
    assert back.hash == demos.hash  # info, states, controls, times and goals
    assert (back.success == demos.success).all()
    for name in ("indices", "seeds", "costs"):
        np.testing.assert_array_equal(getattr(back, name), getattr(demos, name))


def test_minari_reads_exported_demonstrations(minari, demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"minari:{NAME}")
    dataset = minari.load_dataset(NAME)
    assert dataset.total_episodes == len(demos) and dataset.total_steps == len(demos.controls)
    assert dataset.observation_space.shape == (4,) and dataset.action_space.shape == (1,)
    episode = dataset[1]
    np.testing.assert_array_equal(episode.observations, demos.episode(1).states)
    np.testing.assert_array_equal(episode.actions, demos.episode(1).controls)
    assert episode.observations.dtype == np.float64
    assert episode.terminations.tolist() == [False] * (len(episode) - 1) + [True]
    about = dataset.storage.metadata
    assert about["dt"] == pytest.approx(0.02) and about["planspace"]["info"]["units"][1] == "rad"
    assert "<mujoco" in about["planspace"]["info"]["mjcf"]


def test_demonstrations_without_controls(minari, tmp_path: Path) -> None:
    from planspace.demos.recording import recorded

    info = StateInfo(("x",), ("m",), (), 0)
    bare = Demos.from_episodes(info, [recorded(np.eye(2)[:, :1], np.zeros((1, 0)), np.arange(2.0), 0)])
    export_demos(bare, f"minari:{NAME}")
    assert load(tmp_path).hash == bare.hash


def test_an_existing_dataset_is_not_overwritten(minari, demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"minari:{NAME}")
    before = {p: p.read_bytes() for p in (tmp_path / "minari").rglob("*") if p.is_file()}
    with pytest.raises(PlanspaceError, match="already has a dataset 'cart/pole-v0'"):
        export_demos(demos, f"minari:{NAME}")
    assert before == {p: p.read_bytes() for p in (tmp_path / "minari").rglob("*") if p.is_file()}


def test_a_failed_export_leaves_no_files(
    minari, demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_):
        raise OSError("No space left on device")

    monkeypatch.setattr("minari.dataset._storages.hdf5_storage.HDF5Storage.update_episode_metadata", full)
    with pytest.raises(PlanspaceError, match="cannot write the Minari dataset .* No space left on device"):
        export_demos(demos, f"minari:{NAME}")
    assert not (tmp_path / "minari" / NAME).exists()


def test_read_a_dataset_that_planspace_did_not_write(minari, tmp_path: Path, capsys) -> None:
    make_plain(minari)
    demos = load(tmp_path)
    assert demos.info == StateInfo(("state0", "state1", "state2"), ("", "", ""), (), 1)
    assert demos.states.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert demos.controls.tolist() == [[7], [8]]
    assert demos.times.tolist() == [0, 1, 2]
    assert "1 s is assumed; `demos import --dt SECONDS` sets it" in capsys.readouterr().err


def test_choose_states_and_time_step(minari, tmp_path: Path, capsys) -> None:
    make_plain(minari)
    demos = load(tmp_path, states={"v": "2", "x": "0"}, dt=0.5)
    assert demos.info.names == ("v", "x")
    assert demos.states.tolist() == [[2, 0], [5, 3], [8, 6]]
    assert demos.times.tolist() == [0, 0.5, 1.0]
    assert capsys.readouterr().err == ""


def test_states_of_a_problem_need_the_same_size(minari, tmp_path: Path) -> None:
    make_plain(minari)
    info = StateInfo(("a", "b", "c"), ("m", "rad", "m/s"), (1,), 1)
    assert load(tmp_path, info=info).info == info
    with pytest.raises(
        UsageError, match=r"have 3 numbers, but a state of the problem has 2 \(a, b\); choose them"
    ):
        load(tmp_path, info=StateInfo(("a", "b"), ("", ""), (), 1))


def test_dictionary_observations(minari, tmp_path: Path) -> None:
    from gymnasium.spaces import Dict

    observation_space, goal_space, action_space = boxes(2, 1, 1)
    space = Dict({"observation": observation_space, "goal": goal_space})
    parts = {"observation": np.arange(6.0).reshape(3, 2), "goal": np.array([[9.0], [9.0], [9.0]])}
    make(minari, {k: v.astype(np.float32) for k, v in parts.items()}, np.zeros((2, 1)), space, action_space)
    assert load(tmp_path).states.tolist() == [[0, 1], [2, 3], [4, 5]]
    chosen = {"x": "observation[1]", "g": "goal", "y": "0"}
    import_demos([f"minari:{NAME}"], tmp_path / "chosen", None, ImportOptions(states=chosen))
    assert load_demos(tmp_path / "chosen").states.tolist() == [[1, 9, 0], [3, 9, 2], [5, 9, 4]]


def test_a_dictionary_without_observation_needs_a_choice(minari, tmp_path: Path) -> None:
    from gymnasium.spaces import Dict

    (space, action_space) = boxes(2, 1)
    observations = {"joints": np.zeros((3, 2), dtype=np.float32)}
    make(minari, observations, np.zeros((2, 1)), Dict({"joints": space}), action_space)
    with pytest.raises(UsageError, match="a dictionary with the keys joints; choose the states with --state"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("3", "give an index from 0 to 2"),
        ("joints[0]", "no key 'joints'"),
        ("joints", "no key 'joints'"),
    ],
)
def test_places_that_do_not_exist(place: str, message: str, minari, tmp_path: Path) -> None:
    make_plain(minari)
    with pytest.raises(UsageError, match=message):
        load(tmp_path, states={"x": place})
    assert not (tmp_path / "back").exists()


def test_code_named_in_the_metadata_is_not_run(minari, demos: Demos, tmp_path: Path, monkeypatch) -> None:
    """An entry point in the metadata is not imported, whether or not the metadata contain the spaces."""
    trap = tmp_path / "trap"
    (trap / "planspace_trap").mkdir(parents=True)
    (trap / "planspace_trap" / "__init__.py").write_text("raise SystemExit('the trap was sprung')")
    monkeypatch.syspath_prepend(str(trap))
    export_demos(demos, f"minari:{NAME}")
    file = tmp_path / "minari" / NAME / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    spec = {"id": "Trap-v0", "entry_point": "planspace_trap:Env", "additional_wrappers": [], "kwargs": {}}
    metadata["env_spec"] = metadata["eval_env_spec"] = json.dumps(spec)
    file.write_text(json.dumps(metadata))
    assert load(tmp_path).hash == demos.hash
    del metadata["observation_space"]  # Minari would look for it in the environment
    file.write_text(json.dumps(metadata))
    with pytest.raises(
        PlanspaceError, match="has no observation_space; to find it, planspace would have to run code"
    ):
        load(tmp_path)
    assert "planspace_trap" not in sys.modules


def test_images_are_refused(minari, tmp_path: Path) -> None:
    from gymnasium.spaces import Box

    pictures = np.zeros((3, 8, 8), dtype=np.uint8)
    make(minari, pictures, np.zeros((2, 1)), Box(0, 255, (8, 8), np.uint8), boxes(1)[0])
    with pytest.raises(PlanspaceError, match=r"must be vectors of numbers, got uint8 of shape \(8, 8\)"):
        load(tmp_path)


def test_damaged_planspace_metadata_are_refused(minari, demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"minari:{NAME}")
    file = tmp_path / "minari" / NAME / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    metadata["planspace"]["info"]["circular_columns"] = [7]
    file.write_text(json.dumps(metadata))
    with pytest.raises(PlanspaceError, match="contradicts itself"):
        load(tmp_path)
    metadata["planspace"] = "something else"
    file.write_text(json.dumps(metadata))
    with pytest.raises(PlanspaceError, match="is damaged"):
        load(tmp_path)


def test_missing_datasets_and_malformed_names(minari, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="`minari download D4RL/door/human-v2`"):
        load(tmp_path, "D4RL/door/human-v2")
    for name in ("../secrets-v0", "/etc-v0", "door", ""):
        with pytest.raises(UsageError, match="is not a Minari name"):
            load(tmp_path, name)


def test_dt_is_refused_for_an_exported_dataset(minari, demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"minari:{NAME}")
    with pytest.raises(UsageError, match="has its own times"):
        load(tmp_path, dt=0.1)


def test_error_without_minari_says_what_to_install(
    demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(PlanspaceError, match=r"pip install .*\[minari\]'"):
        load(tmp_path)
    with pytest.raises(PlanspaceError, match=r"pip install .*\[minari\]'"):
        export_demos(demos, f"minari:{NAME}")
