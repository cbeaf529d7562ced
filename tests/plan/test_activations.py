"""Planning, storing, embedding and training with actuators that have a state."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

import planspace as ps
from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.demos.dataset import Demos
from planspace.demos.describe import validate
from planspace.demos.load import load_demos
from planspace.embed.config import PRESETS
from planspace.errors import PlanspaceError
from planspace.mjcf.compile import load_model
from planspace.mjcf.read import read_keyframe, read_model
from planspace.mjcf.source import ModelFile
from planspace.physics.simulator import Simulator
from planspace.plan import linearise
from planspace.plan.config import PlanConfig, RegulatorConfig
from planspace.plan.demonstrations import plan_demos
from planspace.plan.regulator import Regulator
from planspace.tasks.problem_file import load_problem
from planspace.tasks.stored_task import problem_yaml

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.01"/>
  <worldbody><body name="arm"><joint name="j" axis="0 1 0" range="-2 2" damping="0.2"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/></body></worldbody>
  <tendon><fixed name="front"><joint joint="j" coef="0.05"/></fixed></tendon>
  <actuator>{actuators}</actuator>
  <keyframe><key name="up" qpos="0.5" act="{act}"/></keyframe></mujoco>"""
ACTUATORS = {
    "filter": '<general name="m" joint="j" dyntype="filter" dynprm="0.1" gainprm="3" ctrlrange="-1 1"/>',
    "velocity": '<intvelocity name="m" joint="j" kp="20" kv="1" actrange="-2 2" ctrlrange="-3 3"/>',
    "muscles": '<muscle name="front" tendon="front" force="60" lengthrange="-0.1 0.1"/>'
    '<muscle name="back" joint="j" gear="-0.05" force="60" lengthrange="-0.1 0.1"/>',
}
ACTIVATIONS = {"filter": ("act_m",), "velocity": ("act_m",), "muscles": ("act_front", "act_back")}
YAML = """model: m.xml
joints: [j]
start: {start}
goal: {goal}
tolerance: 0.1
sample_velocity: 6
task: {{horizon_s: 1}}
"""
QUICK = replace(PRESETS["modern"], steps=20, batch=16)


def write_problem(
    folder: Path, kind: str, *, start: str = "{low: [0.9, 0], high: [1.3, 0]}", goal: str = "[-0.8, 0]"
) -> Path:
    """A problem file of a one-joint arm, and its model."""
    act = "0.3 0.1" if kind == "muscles" else "0.3"
    (folder / "m.xml").write_text(ARM.format(actuators=ACTUATORS[kind], act=act))
    (folder / f"{kind}.yaml").write_text(YAML.format(start=start, goal=goal))
    return folder / f"{kind}.yaml"


@pytest.mark.parametrize("kind", list(ACTUATORS))
def test_a_plan_with_activations_replays_in_plain_mujoco(kind: str, tmp_path: Path) -> None:
    path = write_problem(tmp_path, kind)
    config = PlanConfig.for_problem(load_problem(path), restarts=1, polish_max_iterations=10)
    demos = plan_demos(str(path), 1, config=config, workers=0, verbose=False)
    check_plans(demos, tmp_path)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=pytest.mark.slow if kind == "filter" else pytest.mark.nightly)
        for kind in ACTUATORS
    ],
)
def test_plans_with_activations_are_stored_and_embedded(kind: str, tmp_path: Path) -> None:
    path = write_problem(tmp_path, kind)
    config = PlanConfig.for_problem(load_problem(path), restarts=1, polish_max_iterations=10)
    plan_demos(str(path), 6, config=config, out=tmp_path / "demos", workers=0, verbose=False)
    demos = load_demos(tmp_path / "demos")
    check_plans(demos, tmp_path)
    assert validate(tmp_path / "demos", replay_controls=True).get("replay_error", 1.0) <= 1e-12
    embedding = ps.fit_embedding(demos, config=QUICK, num_seeds=1, verbose=False)
    assert embedding.inputs.names == demos.info.names
    z = embedding.encode(demos.states)
    assert np.isfinite(z).all()
    obs, _ = ps.make_env(path, embedding=embedding).reset(seed=0)
    assert len(obs) == len(demos.info.names) + z.shape[1]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    foreign, _ = ps.wrap(Foreign(model), embedding, mode="replace").reset()
    state = np.append([0.1, -0.2], np.full(model.na, 0.4))
    np.testing.assert_allclose(foreign, embedding.encode(state), rtol=1e-4)


@pytest.mark.parametrize("kind", list(ACTUATORS))
def test_a_task_observes_activations(kind: str, tmp_path: Path) -> None:
    path = write_problem(tmp_path, kind)
    env: Any = ps.make_env(path)
    names = ("j", "jvel", *(ACTIVATIONS[kind]))
    assert env.unwrapped.state_names == tuple(env.unwrapped.obs_fields) == names
    obs, info = env.reset(seed=0)
    assert obs.shape == (len(names),)
    np.testing.assert_array_equal(info["state"][2:], 0)
    obs, reward, *_, info = env.step(env.action_space.high)
    assert (info["state"][2:] != 0).all() and np.isfinite(reward)
    np.testing.assert_allclose(obs, info["state"], rtol=1e-6)
    given = np.append([0.2, 0.0], np.full(len(names) - 2, 0.25))
    env.reset(options={"state": given})
    np.testing.assert_array_equal(env.unwrapped.state, given)
    env.step(np.zeros(env.action_space.shape))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    data = mujoco.MjData(model)
    data.qpos[:], data.act[:] = 0.2, 0.25
    mujoco.mj_step(model, data, env.unwrapped.task.frame_skip)
    plain = np.concatenate([data.qpos, data.qvel, data.act])
    np.testing.assert_array_equal(env.unwrapped.state, plain)


@pytest.mark.parametrize("kind", list(ACTUATORS))
def test_a_controller_holds_a_goal_with_its_activations(kind: str, tmp_path: Path) -> None:
    problem = load_problem(write_problem(tmp_path, kind))
    config = ControlConfig(cost="reward", samples=16, horizon_s=0.2)
    controller = ps.Controller(problem, config=config, threads=1)
    plant = Plant.find(problem)
    state = plant.goal(np.empty(0)).center
    state[0] += 0.02
    simulator = plant.simulator(1)
    simulator.reset(state[None])
    for _ in range(10):
        simulator.step(controller(simulator.states()[0])[None], plant.task.frame_skip)
        assert controller.regulated
    assert abs(simulator.states()[0, 0] + 0.8) < 0.02


def check_plans(demos: Demos, folder: Path) -> None:
    """Plans end at the goal, and their controls give the same states in the user's own model."""
    user = mujoco.MjModel.from_xml_path(str(folder / "m.xml"))
    for i in range(len(demos)):
        episode = demos.episode(i)
        assert np.abs(episode.states[-1, :2] - [-0.8, 0]).sum() <= 0.1
        assert (episode.states[0, 2:] == 0).all()
        assert np.abs(episode.states[:, 2:]).max() > 0.1
        np.testing.assert_allclose(plain_replay(user, episode), episode.states, atol=1e-12, rtol=0)


def plain_replay(model: mujoco.MjModel, episode: Any) -> np.ndarray:
    """The states of a demonstration, simulated in plain MuJoCo."""
    data = mujoco.MjData(model)
    first = episode.states[0]
    data.qpos[:], data.qvel[:], data.act[:] = first[:1], first[1:2], first[2:]
    states = [first]
    for control in episode.controls:
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel, data.act]))
    return np.stack(states)


class Foreign(gymnasium.Env):
    """An environment as Gymnasium's for MuJoCo, in one state."""

    observation_space = gymnasium.spaces.Box(-1, 1, (1,))
    action_space = gymnasium.spaces.Box(-1, 1, (1,))

    def __init__(self, model: mujoco.MjModel):
        self.model, self.data = model, mujoco.MjData(model)

    def reset(self, **_: Any) -> tuple[np.ndarray, dict[str, Any]]:
        self.data.qpos[:], self.data.qvel[:], self.data.act[:] = 0.1, -0.2, 0.4
        return np.zeros(1, np.float32), {}


@pytest.mark.parametrize("kind", list(ACTUATORS))
def test_the_linear_model_has_activations(kind: str, tmp_path: Path, rng: np.random.Generator) -> None:
    model, space = load_problem(write_problem(tmp_path, kind)).compile()
    simulator, count = Simulator(model, space, 8, threads=1), 5
    middle = 0.5 * (simulator.control_low + simulator.control_high)
    states = 0.3 * space.sample(rng, count, np.ones(1))
    states[:, 2:] += 0.1
    controls = middle + rng.uniform(-0.1, 0.1, (count, model.nu))
    a, b = linearise.along(simulator, states, controls, 2)
    dx, du = rng.normal(0, 1e-5, (count, space.tangent_size)), rng.normal(0, 1e-5, controls.shape)
    ends, ids = [], np.arange(count, dtype=np.int32)
    for x, u in ((states, controls), (states + dx, controls + du)):
        simulator.reset(x, ids)
        simulator.step(u, 2, ids=ids)
        ends.append(simulator.states()[:count])
    predicted = np.einsum("kij,kj->ki", a, dx) + np.einsum("kij,kj->ki", b, du)
    np.testing.assert_allclose(ends[1] - ends[0], predicted, atol=2e-8)
    assert np.abs(predicted[:, 2:]).min() > 1e-7


def test_at_a_limit_an_activation_is_only_moved_inwards(tmp_path: Path) -> None:
    model, space = load_problem(write_problem(tmp_path, "velocity")).compile()
    simulator = Simulator(model, space, 16, threads=1)
    inner, limit = np.array([[0.0, 0.0, 1.9]]), np.array([[0.0, 0.0, 2.0]])
    a, _ = linearise.along(simulator, inner, np.zeros((1, 1)))
    np.testing.assert_allclose(
        linearise.along(simulator, limit, np.zeros((1, 1)))[0], a, rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize("kind", list(ACTUATORS))
def test_free_activations_of_a_goal_hold_it(kind: str, tmp_path: Path) -> None:
    """At -0.8 rad gravity turns the arm with 0.5 * 9.81 * 0.15 * cos(0.8) = 0.513 Nm."""
    problem = load_problem(write_problem(tmp_path, kind))
    model, space = problem.compile()
    simulator = Simulator(model, space, 16, threads=1)
    goal = linearise.at_rest(simulator, problem.draw_goal(space, np.random.default_rng(0)))
    np.testing.assert_array_equal(goal.center[:2], [-0.8, 0])
    data = mujoco.MjData(model)
    data.qpos[:], data.act[:] = -0.8, goal.center[2:]
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[0] == pytest.approx(-0.513, abs=2e-3)
    control = Regulator(simulator, goal, problem.weights(space), RegulatorConfig()).hold_control
    data.ctrl[:] = control
    mujoco.mj_step(model, data, 20)
    assert abs(data.qpos[0] + 0.8) < 1e-3


def test_a_start_and_a_goal_may_name_activations(tmp_path: Path) -> None:
    path = write_problem(
        tmp_path, "filter", start="[0, 0, 0.4]", goal="{low: [1, 0, -0.1], high: [1, 0, 0.1]}"
    )
    problem = load_problem(path)
    _, space = problem.compile()
    assert problem.box("start", space).low == (0, 0, 0.4)
    goal = problem.draw_goal(space, np.random.default_rng(0))
    assert goal.weights.tolist() == [1, 1, 1]
    assert goal.distance(np.array([1, 0, 0.3])) == pytest.approx(0.2)
    free = load_problem(write_problem(tmp_path, "filter"))
    assert free.draw_goal(space, np.random.default_rng(0)).weights.tolist() == [1, 1, 0]
    weighted = replace(free, goal_weights=(2.0, 0.5), feature_weights=(3.0, 0.5))
    assert weighted.weights_to_goal(space).tolist() == [2, 0.5, 0]
    assert weighted.weights(space).tolist() == [3, 0.5, 1]
    (tmp_path / "again.yaml").write_text(problem_yaml(problem))
    again = load_problem(tmp_path / "again.yaml")
    assert (again.start, again.goal) == (problem.start, problem.goal)


def test_a_keyframe_gives_the_activations_of_a_start(tmp_path: Path) -> None:
    path = write_problem(tmp_path, "muscles", start="{keyframe: up}", goal="{keyframe: up}")
    problem = load_problem(path)
    assert problem.start.low == (0.5, 0, 0.3, 0.1)
    assert problem.goal.low == (0.5, 0)
    two = """<mujoco><worldbody>
      <body name="a"><joint/><geom size="0.1"/></body>
      <body name="b"><joint/><geom size="0.1"/></body></worldbody>
      <actuator><motor joint="a"/><general joint="a" dyntype="filter"/><general joint="b" dyntype="filter"/>
      </actuator><keyframe><key name="k" qpos="1 2" act="3 4"/></keyframe></mujoco>"""
    two = two.replace("<joint/>", '<joint name="a"/>', 1).replace("<joint/>", '<joint name="b"/>')
    (tmp_path / "two.xml").write_text(two)
    source = read_model(ModelFile(tmp_path / "two.xml", ("b",)))  # a is held, with its two actuators
    assert load_model(source).na == 1
    assert read_keyframe(source, ("b",), "k") == ([2.0], [0.0], [4.0])


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (
            "filter",
            {"start": "[0, 0, 2]"},
            "start: 'act_m' must lie between -1 and 1, as the model says; got 2",
        ),
        ("filter", {"goal": "[0]"}, "goal must have 3 numbers, or 2 without the activations, got 1"),
        (
            "velocity",
            {"goal": "[0, 0, 0, 0]"},
            "goal must have 3 numbers, or 2 without the activations, got 4",
        ),
    ],
)
def test_activations_that_do_not_fit_are_refused(
    kind: str, change: dict[str, str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(PlanspaceError, match=message):
        load_problem(write_problem(tmp_path, kind, **change))


def test_an_integrator_without_a_range_is_refused(tmp_path: Path) -> None:
    path = write_problem(tmp_path, "filter")
    text = (tmp_path / "m.xml").read_text().replace('dyntype="filter"', 'dyntype="integrator"')
    (tmp_path / "m.xml").write_text(text)
    with pytest.raises(PlanspaceError, match="'act_m' has no limits; give its actuator an actrange"):
        load_problem(path)
