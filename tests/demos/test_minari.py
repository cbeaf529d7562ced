import json
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_demos, import_demos
from planspace.demos.dataset import Demos, StateInfo
from planspace.demos.folder import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError, UsageError

NAME = "cart/pole-v0"


@pytest.fixture
def minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Minari, with its datasets in a folder of the test."""
    module = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return module


def load(tmp_path: Path, name: str = NAME, info: StateInfo | None = None, **options) -> Demos:
    import_demos([f"minari:{name}"], tmp_path / "back", info, ImportOptions(**options))
    return load_demos(tmp_path / "back")


def make(minari, observations, actions, observation_space, action_space, name: str = NAME) -> None:
    """A dataset that planspace did not write."""
    from minari.data_collector import EpisodeBuffer

    steps = len(actions)
    buffer = EpisodeBuffer(
        observations=observations,
        actions=actions,
        rewards=[0.0] * steps,
        terminations=[False] * steps,
        truncations=[False] * (steps - 1) + [True],
    )
    with pytest.warns(UserWarning):
        minari.create_dataset_from_buffers(
            name, [buffer], observation_space=observation_space, action_space=action_space
        )


def boxes(*sizes: int):
    from gymnasium.spaces import Box

    return [Box(-np.inf, np.inf, (size,), np.float32) for size in sizes]


def make_plain(minari) -> None:
    observations = np.arange(9, dtype=np.float32).reshape(3, 3)
    make(minari, observations, np.array([[7], [8]], dtype=np.float32), *boxes(3, 1))


@pytest.mark.parametrize(("storage", "module"), [("hdf5", "h5py"), ("arrow", "pyarrow")])
def test_export_and_import_give_the_same_dataset(
    storage: str, module: str, minari, demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(module)
    monkeypatch.setattr("planspace.demos.minari._storage_format", lambda: storage)
    export_demos(demos, f"minari:{NAME}")
    back = load(tmp_path)
    assert back.hash == demos.hash  # info, states, controls, times and goals
    assert (back.success == demos.success).all()
    for name in ("indices", "seeds", "costs"):
        np.testing.assert_array_equal(getattr(back, name), getattr(demos, name))


def test_minari_reads_what_was_exported(minari, demos: Demos, tmp_path: Path) -> None:
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


def test_demonstrations_without_controls_come_back_without(minari, tmp_path: Path) -> None:
    from planspace.demos.recording import recorded

    info = StateInfo(("x",), ("m",), (), 0)
    bare = Demos.from_episodes(info, [recorded(np.eye(2)[:, :1], np.zeros((1, 0)), np.arange(2.0), 0)])
    export_demos(bare, f"minari:{NAME}")
    assert load(tmp_path).hash == bare.hash


def test_a_taken_name_is_refused_and_nothing_changes(minari, demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"minari:{NAME}")
    before = {p: p.read_bytes() for p in (tmp_path / "minari").rglob("*") if p.is_file()}
    with pytest.raises(PlanspaceError, match="has a dataset 'cart/pole-v0' already"):
        export_demos(demos, f"minari:{NAME}")
    assert before == {p: p.read_bytes() for p in (tmp_path / "minari").rglob("*") if p.is_file()}


def test_an_export_that_fails_leaves_nothing(
    minari, demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_):
        raise OSError("No space left on device")

    monkeypatch.setattr("minari.dataset._storages.hdf5_storage.HDF5Storage.update_episode_metadata", full)
    with pytest.raises(PlanspaceError, match="cannot write the Minari dataset .* No space left on device"):
        export_demos(demos, f"minari:{NAME}")
    assert not (tmp_path / "minari" / NAME).exists()


def test_a_dataset_of_others(minari, tmp_path: Path, capsys) -> None:
    make_plain(minari)
    demos = load(tmp_path)
    assert demos.info == StateInfo(("state0", "state1", "state2"), ("", "", ""), (), 1)
    assert demos.states.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert demos.controls.tolist() == [[7], [8]]
    assert demos.times.tolist() == [0, 1, 2]
    assert "1 s is assumed; --dt SECONDS sets it" in capsys.readouterr().err


def test_numbers_of_an_observation_are_chosen_and_the_step_is_set(minari, tmp_path: Path, capsys) -> None:
    make_plain(minari)
    demos = load(tmp_path, states={"v": "2", "x": "0"}, dt=0.5)
    assert demos.info.names == ("v", "x")
    assert demos.states.tolist() == [[2, 0], [5, 3], [8, 6]]
    assert demos.times.tolist() == [0, 0.5, 1.0]
    assert capsys.readouterr().err == ""


def test_a_problem_names_the_numbers_where_the_sizes_match(minari, tmp_path: Path) -> None:
    make_plain(minari)
    info = StateInfo(("a", "b", "c"), ("m", "rad", "m/s"), (1,), 1)
    assert load(tmp_path, info=info).info == info
    with pytest.raises(
        UsageError, match=r"have 3 numbers, a state of the problem has 2 \(a, b\); choose with"
    ):
        load(tmp_path, info=StateInfo(("a", "b"), ("", ""), (), 1))


def test_the_observation_of_a_dictionary(minari, tmp_path: Path) -> None:
    from gymnasium.spaces import Dict

    observation_space, goal_space, action_space = boxes(2, 1, 1)
    space = Dict({"observation": observation_space, "goal": goal_space})
    parts = {"observation": np.arange(6.0).reshape(3, 2), "goal": np.array([[9.0], [9.0], [9.0]])}
    make(minari, {k: v.astype(np.float32) for k, v in parts.items()}, np.zeros((2, 1)), space, action_space)
    assert load(tmp_path).states.tolist() == [[0, 1], [2, 3], [4, 5]]
    chosen = {"x": "observation[1]", "g": "goal", "y": "0"}
    import_demos([f"minari:{NAME}"], tmp_path / "chosen", None, ImportOptions(states=chosen))
    assert load_demos(tmp_path / "chosen").states.tolist() == [[1, 9, 0], [3, 9, 2], [5, 9, 4]]


def test_a_dictionary_without_observation_must_be_chosen_from(minari, tmp_path: Path) -> None:
    from gymnasium.spaces import Dict

    (space, action_space) = boxes(2, 1)
    observations = {"joints": np.zeros((3, 2), dtype=np.float32)}
    make(minari, observations, np.zeros((2, 1)), Dict({"joints": space}), action_space)
    with pytest.raises(UsageError, match="a dictionary of joints; choose with --state"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("3", "an index from 0 to 2 is needed"),
        ("joints[0]", "no key 'joints'"),
        ("joints", "no key 'joints'"),
    ],
)
def test_places_that_are_not_there(place: str, message: str, minari, tmp_path: Path) -> None:
    make_plain(minari)
    with pytest.raises(UsageError, match=message):
        load(tmp_path, states={"x": place})
    assert not (tmp_path / "back").exists()


def test_no_code_that_the_metadata_names_is_run(minari, demos: Demos, tmp_path: Path, monkeypatch) -> None:
    """An entry point in the metadata is not imported, with the spaces there and without."""
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
    del metadata["observation_space"]  # this makes Minari look for it in the environment
    file.write_text(json.dumps(metadata))
    with pytest.raises(PlanspaceError, match="names no observation_space; finding it would run code"):
        load(tmp_path)
    assert "planspace_trap" not in sys.modules


def test_pictures_are_no_states(minari, tmp_path: Path) -> None:
    from gymnasium.spaces import Box

    pictures = np.zeros((3, 8, 8), dtype=np.uint8)
    make(minari, pictures, np.zeros((2, 1)), Box(0, 255, (8, 8), np.uint8), boxes(1)[0])
    with pytest.raises(PlanspaceError, match=r"are a uint8 of shape \(8, 8\) each; planspace reads vectors"):
        load(tmp_path)


def test_damaged_metadata_of_ours_is_refused(minari, demos: Demos, tmp_path: Path) -> None:
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


def test_what_is_not_there_and_what_is_no_name(minari, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="`minari download D4RL/door/human-v2`"):
        load(tmp_path, "D4RL/door/human-v2")
    for name in ("../secrets-v0", "/etc-v0", "door", ""):
        with pytest.raises(UsageError, match="is no Minari dataset"):
            load(tmp_path, name)


def test_a_time_step_has_no_meaning_for_our_own(minari, demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, f"minari:{NAME}")
    with pytest.raises(UsageError, match="has times of its own"):
        load(tmp_path, dt=0.1)


def test_without_minari_the_error_says_what_to_install(
    demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(PlanspaceError, match=r"pip install 'planspace\[minari\]'"):
        load(tmp_path)
    with pytest.raises(PlanspaceError, match=r"pip install 'planspace\[minari\]'"):
        export_demos(demos, f"minari:{NAME}")


def record(
    minari, env_id: str, infos: bool = True, num: int = 2, wrap=lambda env: env, **kwargs
) -> np.ndarray:
    """Records random episodes of a task; gives the states of the last."""
    import gymnasium

    env = minari.DataCollector(wrap(gymnasium.make(env_id, **kwargs)), record_infos=infos)
    folders = [env._tmp_dir]
    env.action_space.seed(0)
    for seed in range(num):
        states = [env.reset(seed=seed)[1]["state"]]
        for _ in range(15):
            states.append(env.step(env.action_space.sample())[4]["state"])
    with pytest.warns(UserWarning):
        env.create_dataset(NAME)
    for folder in [*folders, env._tmp_dir]:  # Minari leaves them to the garbage collector, with a warning
        folder.cleanup()
    return np.array(states)


@pytest.mark.parametrize("infos", [True, False])
@pytest.mark.parametrize("obs", ["raw", "trig"])
def test_what_a_task_recorded_needs_no_telling(minari, infos: bool, obs: str) -> None:
    states = record(minari, "planspace/CartPoleSwingUp-v0", infos, obs=obs)
    demos = load_demos(f"minari:{NAME}")
    assert demos.info.names == ("slider", "hinge", "slidervel", "hingevel")
    assert demos.info.problem == "cartpole-swingup" and demos.info.circular_columns == (1,)
    assert len(demos) == 2
    last = demos.episode(1)
    np.testing.assert_allclose(last.times, 0.04 * np.arange(16))
    off = np.round((last.states - states) / (2 * np.pi)) * 2 * np.pi  # whole turns, so that it ends near 0
    np.testing.assert_allclose(last.states - off, states, rtol=1e-6)
    np.testing.assert_array_equal(off[:, [0, 2, 3]], 0.0)


def test_a_problem_takes_its_own_states_or_none(minari, tmp_path: Path) -> None:
    from planspace.plan.demonstrations import state_info
    from planspace.tasks.problem_file import load_problem

    record(minari, "planspace/CartPoleSwingUp-v0")
    balance = load(tmp_path, info=state_info(load_problem("cartpole")))
    assert balance.info.problem == "cartpole" and len(balance) == 2
    with pytest.raises(UsageError, match="recorded from planspace/CartPoleSwingUp-v0, .*has 'shoulder'"):
        load(tmp_path / "other", info=state_info(load_problem("acrobot")))


def test_what_wrappers_did_is_not_taken_for_states(minari, capsys: pytest.CaptureFixture[str]) -> None:
    from gymnasium.wrappers import NormalizeObservation, RescaleAction

    def rescaled(env):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Gymnasium's, of bounds that are not float32
            return RescaleAction(env, -1.0, 1.0)

    record(minari, "planspace/CartPoleSwingUp-v0", wrap=NormalizeObservation, infos=False)
    with pytest.raises(UsageError, match="do not hold the states"):
        load_demos(f"minari:{NAME}")
    minari.delete_dataset(NAME)
    record(minari, "planspace/CartPoleSwingUp-v0", wrap=rescaled)
    load_demos(f"minari:{NAME}")
    assert "recorded through RescaleAction: its controls may not be" in capsys.readouterr().err


@pytest.mark.parametrize(
    "spec", ['{"kwargs": null}', '{"kwargs": {"obs": 3}}', '{"additional_wrappers": [1]}']
)
def test_a_damaged_spec_is_one_line(minari, spec: str) -> None:
    from planspace.demos.recorded_task import recorded_task

    damaged = {"env_spec": json.dumps({"id": "planspace/CartPole-v0", **json.loads(spec)})}
    with pytest.raises(PlanspaceError, match="the environment's spec in the metadata of 'x' is damaged"):
        recorded_task(damaged, "x")
    assert recorded_task({"env_spec": "{"}, "x") is None


def test_shaped_episodes_can_be_recorded(minari, embedding_folder: Path) -> None:
    from planspace.envs.wrappers import PlanSpaceShaping

    record(
        minari,
        "planspace/CartPoleSwingUp-v0",
        wrap=lambda e: PlanSpaceShaping(e, embedding_folder, [0.0] * 4),
    )
    assert len(load_demos(f"minari:{NAME}")) == 2


def test_states_that_were_not_recorded_are_asked_for(minari) -> None:
    record(minari, "planspace/ReacherTrig-v0", infos=False)
    with pytest.raises(UsageError, match=r"do not hold the states \(joint0, .*record_infos=True"):
        load_demos(f"minari:{NAME}")


def test_a_recorded_task_is_embedded_unchanged(minari, tmp_path: Path, capsys) -> None:
    from planspace import load_embedding
    from planspace.cli import main

    record(minari, "planspace/ReacherTrig-v0", num=12)
    small = ["--steps", "20", "--batch", "16", "--seeds", "1"]
    assert main(["embed", f"minari:{NAME}", "--out", str(tmp_path / "e"), *small]) == 0
    capsys.readouterr()
    assert load_embedding(tmp_path / "e").inputs.names == ("joint0", "joint1", "joint0vel", "joint1vel")


# --- files of strangers -----------------------------------------------------------------------------------


def link_out(group, elsewhere: Path) -> None:
    import h5py

    group["observations"] = h5py.ExternalLink(str(elsewhere), "secret")


def link_in(group, elsewhere: Path) -> None:
    import h5py

    group["observations"] = h5py.SoftLink("/episode_0/actions")


def second_name(group, elsewhere: Path) -> None:
    group["observations"] = group["actions"]


def numbers_elsewhere(group, elsewhere: Path) -> None:
    group.create_dataset("observations", (3, 3), "f4", external=[(str(elsewhere), 0, 36)])


def view_elsewhere(group, elsewhere: Path) -> None:
    import h5py

    layout = h5py.VirtualLayout((3, 3), "f4")
    layout[:] = h5py.VirtualSource(str(elsewhere), "secret", (3, 3))
    group.create_virtual_dataset("observations", layout)


def numbers_without_end(group, elsewhere: Path) -> None:
    group.create_dataset("observations", (10**11, 3), "f4", chunks=(1000, 3))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (link_out, "is a link"),
        (link_in, "is a link"),
        (second_name, "has a second name"),
        (numbers_elsewhere, "keeps its numbers in another file"),
        (view_elsewhere, "keeps its numbers in another file"),
        (numbers_without_end, "makes its episode larger than the .* bytes that can be read"),
    ],
)
def test_a_dataset_holds_its_numbers_itself(change, message: str, minari, tmp_path: Path) -> None:
    import h5py

    make_plain(minari)
    load(tmp_path)
    with h5py.File(tmp_path / "secret.hdf5", "w") as secret:
        secret["secret"] = np.full((3, 3), 42, dtype=np.float32)
    file = tmp_path / "minari" / NAME / "data" / "main_data.hdf5"
    with h5py.File(file, "a") as opened:
        del opened["episode_0/observations"]
        change(opened["episode_0"], tmp_path / "secret.hdf5")
    with pytest.raises(PlanspaceError, match=f"{file}: 'episode_0/.*' {message}"):
        load(tmp_path)


def test_groups_in_groups_that_double_are_refused(minari, tmp_path: Path) -> None:
    import h5py

    make_plain(minari)
    with h5py.File(tmp_path / "minari" / NAME / "data" / "main_data.hdf5", "a") as opened:
        group = opened["episode_0"].create_group("infos")
        for _ in range(60):  # 2^60 ways to the last
            inner = group.create_group("a")
            group["b"] = inner
            group = inner
    with pytest.raises(PlanspaceError, match="'episode_0/infos/a' has a second name"):
        load(tmp_path)


@pytest.mark.parametrize("name", ["data", "data/metadata.json", "data/main_data.hdf5"])
def test_a_dataset_leads_nowhere_else(name: str, minari, tmp_path: Path) -> None:
    make_plain(minari)
    (tmp_path / "minari").rename(tmp_path / "other disk")
    (tmp_path / "minari").symlink_to(tmp_path / "other disk")
    load(tmp_path)
    path = tmp_path / "minari" / NAME / name
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(PlanspaceError, match=f"{path} is a link, to {tmp_path / 'elsewhere'}; put a copy"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "observation_space",
            '{"type": "Tuple", "subspaces": [' * 900 + "]}" * 900,
            "cannot read .*recursion",
        ),
        ("observation_space", '{"type": "Box"}', "cannot read .*shape"),
        ("env_spec", "[" * 100_000, "cannot read .*recursion"),
        ("total_episodes", 10**11, "names no sensible number of episodes"),
        ("total_episodes", None, "names no sensible number of episodes"),
        ("total_episodes", 7, "cannot read .*episode_1"),
    ],
)
def test_metadata_that_lie_are_one_line(key: str, value, message: str, minari, tmp_path: Path) -> None:
    make_plain(minari)
    file = tmp_path / "minari" / NAME / "data" / "metadata.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), key: value}))
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path)
