"""A user's own task is made, stepped, wrapped and named, and is refused if it does not fit."""

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import planspace as ps
from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.envs import register_task
from planspace.errors import PlanspaceError, UsageError
from planspace.tasks.catalog import TASKS, add_task, find_task
from planspace.tasks.check_task import check_task
from planspace.tasks.task import Task
from planspace.tasks.task_hash import earlier_hash, with_todays_hash

from .slide_and_spin import MODEL, TASK

MINIMAL = {
    "name": "minimal",
    "model": MODEL,
    "joints": ("slide", "spin"),
    "start_low": [-1, -3, 0, 0],
    "start_high": [1, 3, 0, 0],
    "horizon": 25,
    "reward": lambda before, after, control, target: -np.abs(after[:, 0]),
    "at_goal": lambda states, target: np.abs(states[:, 0]) < 0.1,
}


def pixels(states: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.zeros((len(states), 8, 8))


def embedding_of(task: ps.Task) -> Embedding:
    """An embedding of the task's state with random weights."""
    rng, space = np.random.default_rng(0), task.space
    inputs = Inputs.fit(rng.normal(size=(9, space.size)), space.names, space.units, (), "raw")
    encoder = ([rng.normal(size=(6, space.size))], [np.zeros(6)])
    decoder = ([rng.normal(size=(2 * space.size, 3))], [np.zeros(2 * space.size)])
    return Embedding(inputs, encoder, decoder, 0.0)


def test_everything_else_has_a_default_from_the_model() -> None:
    task = ps.Task(**MINIMAL)
    assert task.frame_skip == 1 and task.target_size == 0 and task.reward_types == ("dense", "sparse")
    assert task.fields("raw") == {"slide": "m", "spin": "rad", "slidevel": "m/s", "spinvel": "rad/s"}
    assert list(task.fields("trig"))[4:] == ["sin_spin", "cos_spin"]  # the slide has no angle
    states, targets = np.array([[0.5, 7.0, 0.0, 1.0]]), np.empty((1, 0))
    wrapped = 7.0 - 2 * np.pi
    np.testing.assert_allclose(task.observe_as("wrapped", states, targets), [[0.5, wrapped, 0.0, 1.0]])
    np.testing.assert_allclose(task.observe_as("trig", states, targets)[0, 4:], [np.sin(7), np.cos(7)])
    assert not task.terminated(states).any()
    env = ps.make_env(task)
    env.reset(seed=0)
    for _ in range(25):
        _, _, ended, truncated, _ = env.step(env.action_space.sample())
    assert truncated and not ended


def test_the_model_can_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "model.xml").write_text(MODEL)
    assert replace(TASK, model=tmp_path / "model.xml").source == TASK.source
    assert TASK.source.text == MODEL
    assert replace(TASK, model=str(tmp_path / "model.xml")).hash == TASK.hash
    with pytest.raises(PlanspaceError, match=r"nothing\.xml"):
        ps.make_env(replace(TASK, model=tmp_path / "nothing.xml"))


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
@pytest.mark.parametrize("obs", ["raw", "trig"])
def test_the_vector_environment_equals_single_ones_bit_for_bit(mode: AutoresetMode, obs: str) -> None:
    ours = ps.make_env(TASK, 5, obs=obs, autoreset_mode=mode, threads=2)
    theirs = SyncVectorEnv([lambda: ps.make_env(TASK, obs=obs)] * 5, autoreset_mode=mode)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert np.array_equal(ours.reset(seed=3)[0], theirs.reset(seed=3)[0])
    ours.action_space.seed(0)
    ends = np.zeros(2)
    for _ in range(60):
        actions = ours.action_space.sample()
        got, wanted = ours.step(actions), theirs.step(actions)
        for a, b in zip(got[:4], wanted[:4], strict=True):
            assert a.dtype == b.dtype and np.array_equal(a, b)
        assert np.array_equal(got[4]["state"], wanted[4]["state"])
        ended = got[2] | got[3]
        ends += [got[2].sum(), got[3].sum()]
        if mode == AutoresetMode.DISABLED and ended.any():
            for env in (ours, theirs):
                env.reset(options={"reset_mask": ended})
    assert (ends > 0).all()  # some terminated, some were truncated


def test_physics_equals_a_plain_loop_of_mj_step() -> None:
    import mujoco

    env = ps.make_env(TASK)
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    _, info = env.reset(seed=0)
    data.qpos[:], data.qvel[:] = info["state"][:2], info["state"][2:]
    env.action_space.seed(0)
    for _ in range(20):
        action = env.action_space.sample()
        info = env.step(action)[4]
        data.ctrl[:] = action
        mujoco.mj_step(model, data, nstep=2)
        np.testing.assert_array_equal(info["state"], [*data.qpos, *data.qvel])


def test_gymnasium_accepts_a_task_as_an_argument() -> None:
    gymnasium.register(
        "tests/SlideAndSpin-v0", entry_point="planspace.envs.task:TaskEnv", kwargs={"task": TASK}
    )
    try:
        env = gymnasium.make("tests/SlideAndSpin-v0", obs="trig")
        assert env.reset(seed=1)[0].shape == (6,)
        assert env.unwrapped.task == TASK  # pyright: ignore
    finally:
        del gymnasium.registry["tests/SlideAndSpin-v0"]


def test_a_registered_task_has_a_name_and_an_id_that_survive_json() -> None:
    task = replace(TASK, name="slide-registered", env_id="tests/Slide-v0")
    register_task(task)
    try:
        register_task(task)  # twice is harmless
        assert find_task("slide-registered") is task
        env = gymnasium.make("tests/Slide-v0")
        assert env.spec is not None and env.spec.max_episode_steps == 25
        again = gymnasium.make(type(env.spec).from_json(env.spec.to_json()))
        assert np.array_equal(again.reset(seed=2)[0], env.reset(seed=2)[0])
        with pytest.raises(UsageError, match="another task is called 'slide-registered'"):
            add_task(replace(task, horizon=3))
    finally:
        del TASKS["slide-registered"], gymnasium.registry["tests/Slide-v0"]


def test_environments_of_a_task_are_pickled_and_copied() -> None:
    for env in (ps.make_env(TASK), ps.make_env(TASK, 3)):
        wanted = env.reset(seed=1)[0]
        for other in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
            assert np.array_equal(other.reset(seed=1)[0], wanted)


def test_an_embedding_in_memory_wraps_single_and_vector_environments() -> None:
    embedding = embedding_of(TASK)
    one = ps.make_env(TASK, embedding=embedding)
    many = ps.make_env(TASK, 3, embedding=embedding, mode="replace")
    obs, info = one.reset(seed=0)
    np.testing.assert_allclose(obs[4:], embedding.encode(info["state"]), atol=1e-6)
    obs, info = many.reset(seed=0)
    np.testing.assert_allclose(obs, embedding.encode(info["state"]), atol=1e-6)
    again = ps.wrap(
        gymnasium.make("Pendulum-v1"), embedding_of(find_task("pendulum-swingup")), columns=[0, 2]
    )
    assert again.observation_space.shape == (6,)


def test_wrap_explains_what_it_takes() -> None:
    embedding = embedding_of(TASK)
    with pytest.raises(UsageError, match=r"wrap takes a gymnasium.Env or a .*VectorEnv, got builtins.int"):
        ps.wrap(3, embedding)  # pyright: ignore
    with pytest.raises(UsageError, match=r"got 'CartPole-v1': use gymnasium.make\('CartPole-v1'\)"):
        ps.wrap("CartPole-v1", embedding)  # pyright: ignore
    with pytest.raises(UsageError, match="unknown task 'cartpol'. Did you mean 'cartpole'"):
        ps.make_env("cartpol")


def test_wrap_explains_what_to_do_for_sb3() -> None:
    sb3 = pytest.importorskip("stable_baselines3.common.vec_env", reason="needs the extra sb3")
    with pytest.raises(UsageError, match=r"wrap each environment before .*make_vec_env\(\.\.\., embedding="):
        ps.wrap(sb3.DummyVecEnv([lambda: ps.make_env(TASK)]), embedding_of(TASK))


def test_the_hash_follows_the_model_the_numbers_and_the_functions() -> None:
    assert TASK.hash == pickle.loads(pickle.dumps(TASK)).hash == copy.deepcopy(TASK).hash
    _ = TASK.space  # what is cached is not part of it
    changes: list[dict[str, Any]] = [
        {"horizon": 26},
        {"model": MODEL.replace("0.5", "0.6")},
        {"start_low": (-1, -3, -1, -0.1)},
        {"at_goal": lambda states, target: np.abs(states[:, 0]) < 0.1},
    ]
    hashes = {replace(TASK, **change).hash for change in changes}
    assert len(hashes | {TASK.hash}) == 5


def test_the_hash_follows_values_that_functions_read(monkeypatch: pytest.MonkeyPatch) -> None:
    def scaled(scale: float) -> Callable[..., np.ndarray]:
        return lambda before, after, control, target: -scale * after[:, 0]

    assert replace(TASK, reward=scaled(1.0)).hash == replace(TASK, reward=scaled(1.0)).hash
    assert replace(TASK, reward=scaled(1.0)).hash != replace(TASK, reward=scaled(2.0)).hash
    before = TASK.hash
    monkeypatch.setattr("tests.tasks.slide_and_spin.REACHED", 0.2)
    assert TASK.hash != before
    poses = find_task("arm"), find_task("pendulum-swingup")
    assert poses[0].hash != replace(poses[0], reward=poses[1].reward).hash  # methods of other poses


def test_the_hash_follows_the_content_of_files_that_functions_read(tmp_path: Path) -> None:
    def rewarded_by(path: Path) -> Task:
        return replace(TASK, reward=lambda *_: np.full(1, float(path.read_text())))

    texts = {"a/number": "1.0", "b/number": "1.0", "c/number": "2.0"}
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    one, moved, other = (rewarded_by(tmp_path / name) for name in texts)
    assert one.hash == moved.hash != other.hash
    assert earlier_hash(one) != earlier_hash(moved)
    assert with_todays_hash({"task_sha256": earlier_hash(moved)}, moved) == {"task_sha256": moved.hash}
    assert with_todays_hash({"task_sha256": other.hash}, moved) == {"task_sha256": other.hash}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "a/b"}, "task 'a/b': name must be letters, digits, '-', '_' and '.', got 'a/b'"),
        ({"joints": "slide"}, "joints must be a list of one joint name or more, got 'slide'"),
        ({"joints": []}, "joints must be a list of one joint name or more"),
        ({"horizon": 0}, "horizon must be a whole number of at least 1, got 0"),
        ({"frame_skip": 0}, "frame_skip must be a whole number of at least 1, got 0"),
        ({"start_low": [0, 0, 0, np.nan]}, "start_low must be a list of finite numbers"),
        ({"start_low": [2, 0, 0, 0]}, "start_low must have as many numbers as start_high and none above it"),
        ({"start_low": [0, 0]}, "start_low must have as many numbers as start_high"),
        ({"reward": None}, "reward must be a function, got None"),
        ({"at_goal": 3}, "at_goal must be a function, got 3"),
    ],
)
def test_a_wrong_value_is_refused_when_the_task_is_made(change: dict[str, Any], message: str) -> None:
    code = task_without_type_checks(change)
    with pytest.raises(UsageError, match=message) as caught:
        code()
    assert str(caught.value).endswith("See docs/howto/own-task.md.")


def task_without_type_checks(change: dict[str, Any]) -> Callable[[], None]:
    """Make a task whose fields are set without the type checks that only the tests have."""
    from planspace.tasks.task import check_fields

    def make() -> None:
        task = ps.Task(**MINIMAL)
        for name, value in change.items():
            object.__setattr__(task, name, tuple(value) if isinstance(value, list) else value)
        check_fields(task)

    return make


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"start_low": [0, 0], "start_high": [0, 0]},
            r"start_low has 2 numbers, a state has 4 \(slide, spin, slidevel, spinvel\)",
        ),
        (
            {"joints": ("slide",), "start_low": [0, 0], "start_high": [0, 0]},
            "joints leaves out 'spin', which the model moves",
        ),
        (
            {"reward": lambda before, after, control, target: after[:, :1]},
            r"reward must return shape \(3,\) for 3 environments, it returned \(3, 1\)",
        ),
        (
            {"reward": lambda before, after, control, target: 1.0},
            "reward must return an array of numbers, it returned a float",
        ),
        (
            {"at_goal": lambda states, target: states[:, 0]},
            "at_goal must return truth values, it returned float64",
        ),
        ({"terminated": lambda states: np.array(False)}, r"terminated must return shape \(3,\)"),
        ({"observe": pixels}, r"observe must return shape \(3, any\) .*, it returned \(3, 8, 8\)"),
        (
            {"obs_fields": (("slide", "m"),)},
            r"observe must return shape \(3, 1\) for 3 environments, it returned \(3, 4\)",
        ),
        ({"reward": lambda before, after, control: 0}, "reward failed: TypeError: .* 3 positional arguments"),
        ({"at_goal": lambda states, target: states[:, 9] > 0}, "at_goal failed: IndexError"),
        (
            {"draw_targets": lambda num, rng: rng.normal(size=num)},
            r"draw_targets must return shape \(3, any\)",
        ),
        ({"trig_columns": (7,)}, r"trig_columns must lie between 0 and 3, got \(7,\)"),
        ({"model": MODEL.split("<actuator>")[0] + "</mujoco>"}, "model has no actuators"),
    ],
)
def test_a_misfit_is_refused_where_it_is_handed_over(change: dict[str, Any], message: str) -> None:
    task = ps.Task(**{**MINIMAL, **change})
    for use in (ps.make_env, lambda task: ps.make_env(task, 2), check_task):
        with pytest.raises(UsageError, match=message) as caught:
            use(task)
        assert "task 'minimal': " in str(caught.value)
        assert str(caught.value).endswith("See docs/howto/own-task.md.")


def test_a_model_that_does_not_fit_its_joints_is_refused() -> None:
    with pytest.raises(UsageError, match="unknown joint 'hip'. Known: slide, spin"):
        ps.make_env(ps.Task(**{**MINIMAL, "joints": ("slide", "hip")}))
    with pytest.raises(PlanspaceError, match="the model does not compile"):
        ps.make_env(ps.Task(**{**MINIMAL, "model": "<mujoco><worldbody/><oops/></mujoco>"}))


def test_a_shipped_task_has_a_short_repr() -> None:
    for task in (*TASKS.values(), TASK):
        check_task(task)
        assert task.name in repr(task) and len(repr(task)) < 100
