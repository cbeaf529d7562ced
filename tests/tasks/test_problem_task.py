"""A problem file is a task: its reward, goal, observations, ends, hash, and what is refused."""

import pickle
import re
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import yaml

import planspace as ps
from planspace.envs.vector import TaskVectorEnv
from planspace.errors import PlanspaceError, UsageError
from planspace.storage.files import write_bytes
from planspace.tasks.catalog import find_task
from planspace.tasks.check_task import check_task
from planspace.tasks.problem_file import load_problem, shipped_problems
from planspace.tasks.problem_task import task_of_problem
from planspace.tasks.stored_task import problem_yaml, save_task, stored_task
from planspace.tasks.task_settings import TaskSettings, Termination
from planspace.tasks.task_values import task_settings

CRANE_XML = """
<mujoco model="crane">
  <option timestep="0.02" integrator="RK4"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1" pos="0 0 -2"/>
    <body name="trolley">
      <joint name="trolley" type="slide" axis="1 0 0" damping="5"/>
      <geom name="trolley" type="box" size="0.15 0.1 0.05" mass="10"/>
      <body name="load">
        <joint name="swing" type="hinge" axis="0 1 0" damping="0.05"/>
        <geom name="load" type="sphere" pos="0 0 -0.8" size="0.1" mass="5"/>
      </body>
    </body>
    <body name="post" pos="1.5 0 -0.8"><geom name="post" type="box" size="0.1 0.1 0.1"/></body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="trolley" gear="60" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""
CRANE = """
model: crane.xml
joints: [trolley, swing]
start: {low: [-1.0, -0.5, -0.1, -0.1], high: [1.0, 0.5, 0.1, 0.1]}
goal: [0.0, 0.0, 0.0, 0.0]
tolerance: 0.1
position_bounds: {trolley: {low: [-2], high: [2]}}
"""
RANDOM = CRANE.replace(
    "goal: [0.0, 0.0, 0.0, 0.0]", "goal: {low: [-1, -0.1, 0, 0], high: [1, 0.1, 0, 0], random: true}"
)
NONE = np.empty((1, 0))


def write(folder: Path, text: str, name: str = "crane.yaml") -> Path:
    (folder / "crane.xml").write_text(CRANE_XML)
    (folder / name).write_text(text)
    return folder / name


def crane(folder: Path, section: str = "", base: str = CRANE) -> ps.Task:
    task = find_task(write(folder, base + section))
    check_task(task)
    return task


def row(*numbers: float) -> np.ndarray:
    return np.array([numbers], dtype=float)


def rewarded(task: ps.Task, state: np.ndarray, control: float = 0.0, target: np.ndarray = NONE) -> float:
    return float(task.reward(state, state, row(control), target)[0])


def test_a_problem_without_a_section_is_a_task(tmp_path: Path) -> None:
    task = crane(tmp_path)
    assert (task.name, task.horizon, task.frame_skip, task.target_size) == ("crane", 100, 2, 0)
    assert task.start_low == (-1.0, -0.5, -0.1, -0.1)
    assert list(task.fields("raw")) == ["trolley", "swing", "trolleyvel", "swingvel"]
    # -(|0.5| + |2 pi + 0.2| the short way round) / 2 - 0.05 (1 / 2)^2; velocities cost nothing
    assert rewarded(task, row(0.5, 2 * np.pi + 0.2, 9, 9), 1.0) == pytest.approx(-0.3625)
    assert rewarded(task, row(0.05, 0.04, 9, 9)) == pytest.approx(-0.045 + 1)
    assert rewarded(task, row(1e9, 0, 0, 0)) == -5
    assert task.at_goal(row(0.05, 0.04, 9, 9), NONE)[0] and not task.at_goal(row(0.07, 0.04, 0, 0), NONE)[0]
    assert not task.terminated(row(3, 0, 0, 0))[0]


def test_goal_weights_and_boxes_decide_the_distance(tmp_path: Path) -> None:
    task = crane(tmp_path, "goal_weights: [2, 0.5, 1, 1]\n")
    assert rewarded(task, row(0.5, 0.2, 0, 0)) == pytest.approx(-0.55)
    task = crane(tmp_path, "task: {reward: {distance: [3, 0], bonus: 0, max_distance: 1}, tolerance: 0.4}\n")
    assert rewarded(task, row(0.3, 0.2, 0, 0)) == pytest.approx(-0.9)
    assert rewarded(task, row(0.5, 0.2, 0, 0)) == -1
    assert task.at_goal(row(0.3, 0.05, 0, 0), NONE)[0]
    box = "goal: {low: [-1, 0, 0, 0], high: [1, 0, 0, 0]}"
    wide = CRANE.replace("goal: [0.0, 0.0, 0.0, 0.0]", box)
    assert rewarded(crane(tmp_path, base=wide), row(1.25, 0, 0, 0)) == pytest.approx(-0.125)
    speed = crane(tmp_path, "goal_weights: [0, 0, 1, 0]\n")  # a goal without positions counts velocities
    assert rewarded(speed, row(1, 1, 0.5, 1)) == pytest.approx(-0.5)


def test_sparse_reward_and_times_in_seconds(tmp_path: Path) -> None:
    task = crane(tmp_path, "task: {reward: sparse, horizon_s: 1, control_step_s: 0.05}\n")
    assert [rewarded(task, row(x, 0, 0, 0), 2.0) for x in (0.05, 0.5)] == [1, 0]
    assert (task.frame_skip, task.horizon) == (2, 25)


@pytest.mark.parametrize(("kind", "angle"), [("raw", 4.0), ("wrapped", 4.0 - 2 * np.pi), ("trig", 4.0)])
def test_observations(kind: str, angle: float, tmp_path: Path) -> None:
    task = crane(tmp_path, f"task: {{observation: {kind}}}\n", RANDOM)
    state, goal = row(0.1, 4.0, 0.2, 0.3), row(0.7, 0.05, 0, 0)
    extra = [np.sin(4.0), np.cos(4.0)] if kind == "trig" else []
    np.testing.assert_allclose(task.observe(state, goal), row(0.1, angle, 0.2, 0.3, *extra, 0.7, 0.05))
    names = ["trolley", "swing", "trolleyvel", "swingvel"] + ["sin_swing", "cos_swing"] * bool(extra)
    assert list(task.fields("raw")) == [*names, "goal_trolley", "goal_swing"]
    assert len(task.fields("trig")) == 8


def test_random_goals_are_valid_targets_of_an_episode(tmp_path: Path, rng: np.random.Generator) -> None:
    task = crane(
        tmp_path, "forbidden_contacts: [[load, post]]\n", RANDOM.replace("high: [1, 0.1", "high: [2, 0.1")
    )
    goals = task.draw_targets(100, rng)
    assert goals.shape == (100, 4) and goals[:, 0].min() > -1
    assert ((goals[:, 0] < 1.4) | (goals[:, 0] > 1.6)).all() and goals[:, 0].max() > 1.6  # beside the post
    assert rewarded(task, goals[:1], target=goals[:1]) == 1
    assert rewarded(task, row(0, 0, 0, 0), target=row(0.5, 0.1, 0, 0)) == pytest.approx(-0.3)


def test_starts_are_valid_and_drawn_for_each_episode_by_itself(tmp_path: Path) -> None:
    base = CRANE.replace("-1.0, -0.5, -0.1", "-1.0, 0.0, -0.1").replace("high: [1.0, 0.5", "high: [1.9, 0.0")
    task = crane(tmp_path, "forbidden_contacts: [[load, post]]\n", base)
    starts, _ = task.sample_starts(100, np.random.default_rng(0))
    assert ((starts[:, 0] < 1.4) | (starts[:, 0] > 1.6)).all() and starts[:, 0].max() > 1.6
    first, _ = task.sample_starts(1, np.random.default_rng(0))
    np.testing.assert_array_equal(first[0], starts[0])
    assert task.sample_starts(0, np.random.default_rng(0))[0].shape == (0, 4)  # no episode ended


def test_episodes_can_end_early_but_that_never_pays(tmp_path: Path) -> None:
    section = "forbidden_contacts: [[load, post]]\n"
    section += "task: {termination: {bounds: true, contacts: true, below: {swing: -1}}}\n"
    task = crane(tmp_path, section)
    states = np.array([[0, 0, 0, 0], [2.1, 0, 0, 0], [1.4, 0, 0, 0], [0, -1.1, 0, 0], [0, 9, 99, 0]])
    assert task.terminated(states).tolist() == [False, True, True, True, False]
    for again in (states[:1], np.tile(states, (2, 1))):  # in batches of other sizes
        assert task.terminated(again).tolist() == [False, True, True, True, False][: len(again)] * (
            len(again) // 5 or 1
        )
    assert rewarded(task, row(0.5, 0, 0, 0)) == pytest.approx(5 - 0.25)
    assert rewarded(task, row(2.1, 0, 0, 0)) == pytest.approx(-1.05)
    only = crane(tmp_path, "task: {termination: {below: {swing: -1}}, reward: {alive: 0}}\n")
    assert rewarded(only, row(0.5, 0, 0, 0)) == pytest.approx(-0.25)


def test_environments_of_a_file_agree(tmp_path: Path) -> None:
    path = write(tmp_path, RANDOM + "control_bounds: {low: [-1], high: [0.5]}\n")
    single, many = ps.make_env(str(path)), ps.make_env(path, num_envs=3)
    assert isinstance(single, gymnasium.Env) and isinstance(many.unwrapped, TaskVectorEnv)
    assert (single.action_space.low, single.action_space.high) == (-1, 0.5)
    first, _ = single.reset(seed=1)
    np.testing.assert_array_equal(many.reset(seed=0)[0][1], first)
    actions = np.array([[-2.0], [0.3], [2.0]], dtype=np.float32)
    obs, reward, *_ = single.step(actions[1])
    batch = many.step(actions)
    np.testing.assert_array_equal(batch[0][1], obs)
    assert batch[1][1] == reward
    assert pickle.loads(pickle.dumps(many.unwrapped.task)).hash == find_task(path).hash


def test_hash_changes_with_the_task_and_not_with_the_planner(tmp_path: Path) -> None:
    task = crane(tmp_path)
    assert task.hash == "5e83fe75413982dcc6df953529bd9f0479c6048cdcb72d80f9866071a5220b12"
    assert crane(tmp_path, "settings: {min_rounds: 2}\n").hash == task.hash
    for section in ("task: {tolerance: 0.2}", "task: {reward: sparse}", "goal_weights: [1, 1, 0, 0]"):
        assert crane(tmp_path, f"{section}\n").hash != task.hash
    problem = load_problem(tmp_path / "crane.yaml")
    assert replace(problem, task=load_problem("cartpole").task).hash == problem.hash
    assert hash(task) is not None


@pytest.mark.parametrize("name", shipped_problems())
def test_a_problem_written_as_a_file_is_the_same(name: str, tmp_path: Path) -> None:
    problem = load_problem(name)
    problem.source.write(tmp_path)
    (tmp_path / f"{name}.yaml").write_text(problem_yaml(problem))
    assert load_problem(tmp_path / f"{name}.yaml") == problem


@pytest.mark.slow
def test_a_run_holds_its_task(tmp_path: Path) -> None:
    run = tmp_path / "run"
    section = "task: {horizon_s: 2, observation: trig, tolerance: 0.2, termination: {below: {swing: -1}}}\n"
    task = crane(tmp_path, section, RANDOM)
    assert stored_task(run) is None
    save_task(task, run)
    again = stored_task(run)
    assert again is not None and again.hash == task.hash
    (run / "task" / "other.yaml").write_text("")
    with pytest.raises(PlanspaceError, match="must hold one problem file, it holds 2"):
        stored_task(run)


def test_the_file_of_a_stored_task_may_have_any_name(tmp_path: Path) -> None:
    task = find_task(write(tmp_path, CRANE, "my crane.yaml"))
    save_task(task, tmp_path / "run")
    again = stored_task(tmp_path / "run")
    assert again is not None and (again.name, again.hash) == ("my-crane", task.hash)


WITH_MESH = CRANE_XML.replace(
    "<worldbody>",
    """<asset><mesh name="hook" file="hook.obj"/></asset><worldbody>
  <geom name="hook" type="mesh" mesh="hook" contype="0" conaffinity="0" pos="0 0 3"/>""",
)
TETRAHEDRON = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.5\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_the_arms_of_a_run_share_the_meshes_of_its_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, run = write(tmp_path, CRANE), tmp_path / "run"
    (tmp_path / "crane.xml").write_text(WITH_MESH)
    (tmp_path / "hook.obj").write_text(TETRAHEDRON + "# padding\n" * 10_000)  # 100 kB
    task = find_task(path)
    arms = [run, run / "train" / "raw", run / "train" / "raw-z"]
    for folder in arms:
        save_task(task, folder)
    first, second, third = (folder / "task" / "hook.obj" for folder in arms)
    assert first.samefile(second) and first.samefile(third)
    texts = [folder / "task" / "crane.xml" for folder in arms]
    assert not texts[0].samefile(texts[1])  # someone may edit it
    write_bytes(second, b"changed")  # as planspace writes files
    assert third.read_text() == (tmp_path / "hook.obj").read_text()
    moved = run.rename(tmp_path / "moved")
    again = stored_task(moved / "train" / "raw-z")
    assert again is not None and again.hash == task.hash

    def no_links(*_: object, **__: object) -> None:
        raise OSError("this file system has no hard links")

    monkeypatch.setattr("os.link", no_links)
    save_task(task, moved / "train" / "copy")
    copy = moved / "train" / "copy" / "task" / "hook.obj"
    assert copy.stat().st_nlink == 1 and copy.read_text() == (tmp_path / "hook.obj").read_text()


def allowed(states: np.ndarray) -> np.ndarray:
    return np.ones(len(states), dtype=bool)


def test_a_task_with_code_is_not_written(tmp_path: Path) -> None:
    problem = replace(load_problem(write(tmp_path, CRANE)), predicate=allowed)
    save_task(task_of_problem(problem), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("task: 3", "task: expected keys and values, got 3"),
        ("task: {horizn_s: 3}", "task: unknown key of task 'horizn_s'. Did you mean 'horizon_s'"),
        ("task: {horizon_s: -1}", "task: horizon_s: must be positive, got -1"),
        ("task: {horizon_s: x}", "task: horizon_s: expected finite numbers, got 'x'"),
        ("task: {horizon_s: 0.01}", "horizon_s must be at least one control step (0.04 s), got 0.01"),
        ("task: {observation: trigg}", "observation: unknown observation .*Did you mean 'trig'"),
        ("task: {reward: spars}", "reward: unknown reward .*Did you mean 'sparse'"),
        ("task: {reward: {effor: 1}}", "reward: unknown key of reward 'effor'. Did you mean 'effort'"),
        ("task: {reward: {effort: -1}}", "reward: effort: weights must not be negative"),
        ("task: {reward: {distance: [1]}}", "distance must have 2 numbers, one for each degree of freedom"),
        ("task: {termination: {contact: true}}", "unknown key of termination 'contact'. Did you mean"),
        (
            "task: {termination: {below: {swng: 0}}}",
            "unknown number of the state 'swng'. Did you mean 'swing'",
        ),
        ("task: {termination: {below: 1}}", "below: expected names of the state with their lowest values"),
        ("task: {termination: {bounds: 1}}", "termination: bounds: expected true or false, got 1"),
        ("task: {termination: {contacts: true}}", "termination: contacts needs forbidden_contacts"),
        ("kinematic: true", "is kinematic: nothing has mass"),
    ],
)
def test_what_does_not_fit_is_refused(section: str, message: str, tmp_path: Path) -> None:
    base = CRANE
    if "kinematic" in section:
        base = (
            CRANE.replace(", -0.1, -0.1]", "]")
            .replace(", 0.1, 0.1]", "]")
            .replace("0.0, 0.0, 0.0, 0.0", "0, 0")
        )
    pattern = message.replace("(", r"\(").replace(")", r"\)")
    with pytest.raises(PlanspaceError, match=pattern):
        find_task(write(tmp_path, f"{base}{section}\n"))


def test_a_file_without_its_ending_is_suggested(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, CRANE)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=r"unknown task 'crane'. Did you mean the problem file crane.yaml\?"):
        find_task("crane")


def test_a_file_name_becomes_a_task_name_and_a_problem_must_fit_its_task(tmp_path: Path) -> None:
    task = find_task(write(tmp_path, CRANE, "my crane (2).yml"))
    assert task.name == "my-crane--2-"
    with pytest.raises(UsageError, match="problem has another model or other joints than the task"):
        replace(task, model="<mujoco/>").compile()
    with pytest.raises(UsageError, match="problem must be a name, a path or a Problem, got 3"):
        replace(task, problem=3)  # pyright: ignore[reportArgumentType]


def test_the_section_in_the_docs_can_be_read() -> None:
    page = (Path(__file__).parents[2] / "docs" / "howto" / "own-task.md").read_text()
    (section,) = re.findall(r"```yaml\n(task:.*?)```", page, re.DOTALL)
    settings = task_settings(yaml.safe_load(section)["task"])
    assert settings.termination.below == (("torso_z", 0.3),)
    same = replace(settings.reward, distance=(), alive=None)
    assert replace(settings, reward=same, tolerance=None, termination=Termination()) == TaskSettings()
