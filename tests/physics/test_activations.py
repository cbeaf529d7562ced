"""States with the activations of filters, integrators and muscles."""

import mujoco
import numpy as np
import pytest

from planspace.mjcf.compile import load_model
from planspace.physics.replay import replay
from planspace.physics.simulator import Simulator, control_bounds
from planspace.physics.space import StateSpace

MODEL = """<mujoco><compiler angle="radian"/><option timestep="0.01" integrator="{integrator}"/>
  <worldbody><body><joint name="a" axis="0 1 0" range="-2 2" damping="0.2"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/>
    <body pos="0.3 0 0"><joint name="b" type="ball"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.2"/></body></body></worldbody>
  <tendon><fixed name="t"><joint joint="a" coef="-0.05"/></fixed></tendon>
  <actuator>
    <motor name="plain" joint="a" ctrlrange="-1 1"/>
    <general name="slow" joint="a" dyntype="filter" dynprm="0.1" ctrlrange="-0.5 1"/>
    <general joint="a" dyntype="filterexact" dynprm="0.05" ctrlrange="-1 1" actlimited="true"
      actrange="-0.2 0.9"/>
    <intvelocity name="servo" joint="a" kp="3" actrange="-2 2" ctrlrange="-1 1"/>
    <muscle name="flexor" tendon="t" force="30" lengthrange="-0.1 0.1"/>
  </actuator></mujoco>"""


def model_with(integrator: str = "Euler") -> tuple[mujoco.MjModel, StateSpace]:
    model = load_model(MODEL.format(integrator=integrator))
    return model, StateSpace.from_model(model, ["a", "b"])


def test_activations_follow_the_velocities_and_have_ranges() -> None:
    model, space = model_with()
    activations = ("act_slow", "act_3", "act_servo", "act_flexor")
    assert space.names[-8:] == ("avel", "b_rxvel", "b_ryvel", "b_rzvel", *activations)
    assert space.units[-4:] == ("",) * 4
    assert (space.size, space.tangent_size, space.num_activations) == (1 + 4 + 4 + 4, 4 + 4 + 4, 4)
    assert space.activations.low.tolist() == [-0.5, -0.2, -2, 0]
    assert space.activations.high.tolist() == [1, 0.9, 2, 1]
    np.testing.assert_allclose(space.default_weights(np.ones(4))[-4:], [2 / 1.5, 2 / 1.1, 0.5, 2])
    low, high = control_bounds(model, space)
    assert (low[-1], high[-1]) == (0, 1)  # a muscle clips its control to this range
    kinematic = StateSpace.from_model(model, ["a", "b"], kinematic=True)
    assert (kinematic.size, kinematic.num_activations) == (5, 0)


def test_samples_features_and_steps_have_activations(rng: np.random.Generator) -> None:
    _, space = model_with()
    states = space.sample(rng, 500, np.ones(4))
    low, high = states[:, -4:].min(axis=0), states[:, -4:].max(axis=0)
    assert (low >= space.activations.low).all() and (high <= space.activations.high).all()
    assert (high - low > 0.9 * (space.activations.high - space.activations.low)).all()
    step = rng.normal(0, 0.1, (500, 12))
    np.testing.assert_allclose(space.difference(space.integrate(states, step), states), step, atol=1e-12)
    weights = np.ones(12)
    np.testing.assert_array_equal(space.features(states, weights)[:, -4:], states[:, -4:])
    assert space.in_bounds(states).all()
    states[0, -1] = np.nan
    assert not space.in_bounds(states)[0]
    # the distance to a goal does not count them, unless weights do
    other = states[1].copy()
    other[-4:] += 1.0
    assert space.distance(other, states[1]) == pytest.approx(0, abs=1e-12)
    assert space.distance(other, states[1], weights) == pytest.approx(4)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_a_state_with_activations_steps_as_in_plain_mujoco(integrator: str, rng: np.random.Generator) -> None:
    model, space = model_with(integrator)
    starts, controls = space.sample(rng, 6, np.ones(4)), rng.uniform(-1, 1, (20, 6, 5))
    simulator = Simulator(model, space, 8, threads=2)
    ids = np.array([0, 1, 2, 4, 5, 7], dtype=np.int32)
    simulator.step(np.ones((8, 5)), 10)  # what was there before must not matter
    simulator.reset(starts, ids)
    np.testing.assert_array_equal(simulator.states()[ids], starts)
    for step in controls:
        simulator.step(step, ids=ids)
    for i, start in enumerate(starts):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.act[:] = start[:5], start[5:9], start[9:]
        for step in controls:
            data.ctrl[:] = step[i]
            mujoco.mj_step(model, data)
        plain = np.concatenate([data.qpos, data.qvel, data.act])
        np.testing.assert_array_equal(simulator.states()[ids[i]], plain)
        times = np.arange(21) * model.opt.timestep
        np.testing.assert_array_equal(replay(model, space, start, controls[:, i], times)[-1], plain)
    assert not simulator.diverged().any()
    broken = starts.copy()
    broken[0, -1] = np.nan
    simulator.reset(broken, ids)
    assert simulator.diverged()[ids].tolist() == [True] + [False] * 5


def test_edges_end_with_the_activations_of_plain_mujoco(rng: np.random.Generator) -> None:
    model, space = model_with()
    simulator = Simulator(model, space, 4, threads=1)
    starts, controls = space.sample(rng, 3, np.full(4, 0.1)), rng.uniform(-0.2, 0.2, (3, 5))
    ends, _ = simulator.propagate(starts, controls, np.array([2, 5, 3]))
    for i, n in enumerate((2, 5, 3)):
        times = np.arange(n + 1) * model.opt.timestep
        clipped = np.clip(controls[i], simulator.control_low, simulator.control_high)
        plain = replay(model, space, starts[i], np.repeat(clipped[None], n, axis=0), times)
        np.testing.assert_array_equal(ends[i], plain[-1])
