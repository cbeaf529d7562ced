from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.compile import load_model
from planspace.physics.replay import advance, replay
from planspace.physics.simulator import Simulator, Validity
from planspace.physics.space import StateSpace
from planspace.tasks.catalog import TASKS

RELEASED_TOLERANCE = 1e-3
RELEASED_STEPS = 50


RELEASED = [("cartpole", "cartpole_swingup.npz"), ("reacher-raw", "reacher_limited.npz")]


@pytest.mark.parametrize(("task", "file"), RELEASED)
def test_some_released_controls_replay(released: Path, task: str, file: str) -> None:
    assert_controls_replay(task, np.load(released / file), every=25)


@pytest.mark.nightly
@pytest.mark.parametrize(("task", "file"), RELEASED)
def test_all_released_controls_replay(released: Path, task: str, file: str) -> None:
    assert_controls_replay(task, np.load(released / file), every=1)


def assert_controls_replay(task: str, data: Mapping[str, np.ndarray], *, every: int) -> None:
    """The controls of every n-th released plan, with their own time steps, give its states (2020 plant)."""
    model, space = TASKS[task].compile()

    def worst(model: mujoco.MjModel) -> float:
        errors = []
        for a, b in zip(data["offsets"][:-1:every], data["offsets"][1::every], strict=True):
            stop = min(b, a + RELEASED_STEPS + 1)
            states = data["states"][a:stop].astype(float)
            times = data["time"][a:stop].astype(float)
            controls = data["controls"][a : stop - 1].astype(float)
            errors.append(np.abs(replay(model, space, states[0], controls, times) - states).max())
        return max(errors)

    assert worst(model) <= RELEASED_TOLERANCE
    model.dof_damping[0] *= 1.01  # the planted fault: one percent more damping is found
    assert worst(model) > RELEASED_TOLERANCE


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_batch_equals_a_plain_loop_bit_for_bit(threads: int, rng: np.random.Generator) -> None:
    model, space = TASKS["cartpole-swingup"].compile()
    starts = rng.uniform(-0.5, 0.5, (7, 4))
    controls = rng.uniform(-3, 3, (20, 7, 1))
    simulator = Simulator(model, space, 7, threads=threads)
    simulator.reset(starts)
    for step in controls:
        simulator.step(step)
    times = np.arange(21) * model.opt.timestep
    plain = [replay(model, space, starts[i], controls[:, i], times)[-1] for i in range(7)]
    np.testing.assert_array_equal(simulator.states(), plain)


def test_propagate_gives_each_edge_its_own_duration(rng: np.random.Generator) -> None:
    model, space = TASKS["cartpole-swingup"].compile()
    simulator = Simulator(model, space, 16, threads=1)
    starts, controls = rng.uniform(-0.3, 0.3, (10, 4)), rng.uniform(-3, 3, (10, 1))
    durations = np.array([3, 1, 10, 7, 3, 2, 9, 1, 5, 4])
    ends, valid = simulator.propagate(starts, controls, durations)
    assert valid.all()
    for i, n in enumerate(durations):
        plain = replay(model, space, starts[i], np.repeat(controls[i : i + 1], n, 0), np.arange(n + 1) * 0.02)
        np.testing.assert_array_equal(ends[i], plain[-1])


def test_an_edge_that_leaves_the_rail_in_between_is_invalid() -> None:
    model, space = TASKS["cartpole-swingup"].compile()
    simulator = Simulator(model, space, 2, threads=1)
    starts = np.array([[0.98, np.pi, 3.0, 0.0], [0.0, np.pi, 0.0, 0.0]])
    # full thrust backwards: the first leaves the rail before it reverses
    ends, valid = simulator.propagate(starts, np.array([[-3.0], [-3.0]]), np.array([10, 10]))
    assert abs(ends[0, 0]) < 1.0  # it ends inside the rail
    assert valid.tolist() == [False, True]


def test_divergence_is_reported_and_does_not_reset_the_state() -> None:
    task = TASKS["cartpole-swingup"]
    model, space = task.compile()
    model.opt.timestep = 50.0
    simulator = Simulator(model, space, 2, threads=1)
    simulator.reset(np.array([[0.5, 1.0, 30.0, 40.0], [0.5, 1.0, 30.0, 40.0]]))
    for _ in range(20):
        simulator.step(np.array([[3.0], [3.0]]))
    assert simulator.diverged().all()
    simulator.reset(np.zeros((1, 4)), np.array([0], dtype=np.int32))
    assert simulator.diverged().tolist() == [False, True]  # a reset clears only its own warnings


LEVER = """<mujoco><worldbody><body>
  <joint name="j" type="hinge" axis="0 1 0"/><geom size="0.1" pos="0 0 1"/></body></worldbody>
  <actuator><motor joint="j" ctrlrange="-1 1"/></actuator></mujoco>"""


def diverging_model() -> mujoco.MjModel:
    model = load_model(LEVER)
    model.opt.timestep = 1e6
    return model


def test_a_mujoco_warning_alone_makes_an_edge_invalid() -> None:
    model = diverging_model()
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # MuJoCo resets the state silently
    space = replace(StateSpace.from_model(model, ["j"]), velocity_bound=np.array([np.inf]))
    simulator = Simulator(model, space, 4, threads=1)
    ends, valid = simulator.propagate(np.zeros((4, 2)), np.ones((4, 1)), np.full(4, 10))
    assert np.isfinite(ends).all() and space.in_bounds(ends).all()
    assert not valid.any()


def test_diverging_physics_print_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    model = diverging_model()
    space, data = StateSpace.from_model(model, ["j"]), mujoco.MjData(model)
    simulator = Simulator(model, space, 4)
    for _ in range(20):
        simulator.step(np.ones((4, 1)))
        advance(model, data, space, np.ones(1))
    simulator.mujoco_data(0)
    assert simulator.diverged().all()
    assert capfd.readouterr() == ("", "") and list(tmp_path.iterdir()) == []
    mujoco.mj_resetData(model, data)
    data.ctrl[:] = 1.0
    mujoco.mj_step(model, data, nstep=20)  # outside of our functions MuJoCo warns as usual
    assert "WARNING" in capfd.readouterr().err and (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_a_model_with_too_little_memory_raises_our_error() -> None:
    boxes = 30 * '<geom type="box" size="1 1 1"/>'
    model = load_model(f"""<mujoco><size memory="20K"/><worldbody><geom type="plane" size="1 1 1"/>
      <body><freejoint/>{boxes}</body><body pos="5 5 1"><joint name="j"/><geom size="0.1"/></body>
    </worldbody></mujoco>""")
    space, data = StateSpace.from_model(model, ["j"]), mujoco.MjData(model)
    with pytest.raises(PlanspaceError, match="MuJoCo cannot simulate the model: .*out of memory"):
        Simulator(model, space, 2).step(np.zeros((2, 0)))
    with pytest.raises(PlanspaceError, match="MuJoCo cannot simulate the model: .*out of memory"):
        advance(model, data, space, np.zeros(0))


def test_a_model_that_does_not_compile_quotes_mujoco() -> None:
    with pytest.raises(PlanspaceError, match="the model does not compile: .*unrecognized"):
        load_model("<mujoco><worldbody><nonsense/></worldbody></mujoco>")


def test_the_automatic_reset_is_off() -> None:
    model = load_model("<mujoco/>")
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert StateSpace.from_model(model, []).size == 0


BALL_AND_WALLS = """<mujoco><option timestep="0.01"/><worldbody>
  <geom name="left" type="box" pos="-1 0 0" size="0.1 1 1"/>
  <geom name="right" type="box" pos="1 0 0" size="0.1 1 1"/>
  <body><joint name="x" type="slide" axis="1 0 0" range="-2 2" limited="true"/>
    <geom name="ball" size="0.1"/></body>
</worldbody>
<actuator><motor joint="x" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("forbidden", "valid"),
    [
        ("none", [True, True, True]),
        ("all", [True, False, False]),
        ((("ball", "left"),), [True, False, True]),
        ((("right", "ball"),), [True, True, False]),
    ],
)
@pytest.mark.parametrize("kinematic", [False, True])
def test_forbidden_contacts_make_edges_and_states_invalid(
    forbidden: str | tuple[tuple[str, str], ...], valid: list[bool], kinematic: bool
) -> None:
    validity = Validity(forbidden)
    model = load_model(BALL_AND_WALLS, validity.pairs)
    space = StateSpace.from_model(model, ["x"], kinematic=kinematic)
    simulator = Simulator(model, space, 3, threads=1, validity=validity)
    moving = [[0.0, 0.0], [-0.75, -2.0], [0.75, 2.0]]  # the walls begin at 0.8 for the ball's centre
    starts = np.array([row[: space.size] for row in moving])
    controls = np.array([[0.0], [-5.0], [5.0]])
    _, found = simulator.propagate(starts, controls, np.array([10, 10, 10]))
    assert found.tolist() == valid
    inside = np.zeros((3, space.size))
    inside[:, 0] = 0.0, -0.95, 0.95
    assert simulator.valid_states(inside).tolist() == valid


def test_a_predicate_can_forbid_states_along_an_edge() -> None:
    model = load_model(BALL_AND_WALLS)
    space = StateSpace.from_model(model, ["x"], kinematic=True)
    validity = Validity(predicate=lambda x: np.abs(x[:, 0] - 0.2) > 0.05)
    simulator = Simulator(model, space, 2, threads=1, validity=validity)
    # at 50 m/s a step of 0.01 s is 0.5 m: the first jumps over 0.2, the second stops there after one step
    ends, valid = simulator.propagate(np.zeros((2, 1)), np.array([[50.0], [20.0]]), np.array([1, 2]))
    np.testing.assert_allclose(ends[:, 0], [0.5, 0.4])
    assert valid.tolist() == [True, False]


def test_unknown_geoms_and_actuators_with_a_hidden_state_are_rejected() -> None:
    with pytest.raises(UsageError, match="unknown geom or body 'bal'. Did you mean 'ball'"):
        load_model(BALL_AND_WALLS, (("bal", "left"),))
    model = load_model(BALL_AND_WALLS.replace("<motor", '<general dyntype="user" actdim="1"'))
    with pytest.raises(UsageError, match="the actuator 0 has an activation that planspace does not support"):
        Simulator(model, StateSpace.from_model(model, ["x"]), 1)


def test_contact_sensors_do_not_change_the_dynamics() -> None:
    plain, watched = load_model(BALL_AND_WALLS), load_model(BALL_AND_WALLS, (("ball", "left"),))
    assert (plain.nsensor, watched.nsensor) == (0, 1)
    controls, times = np.linspace(-1, 1, 60)[:, None], np.arange(61) * 0.01
    rolled = [
        replay(m, StateSpace.from_model(m, ["x"]), np.array([-0.5, -3.0]), controls, times)
        for m in (plain, watched)
    ]
    np.testing.assert_array_equal(*rolled)
