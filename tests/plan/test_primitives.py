"""Action primitives, greedy selection and body features of SST."""

from dataclasses import replace

import numpy as np
import pytest

from planspace.errors import UsageError
from planspace.physics.simulator import Simulator
from planspace.plan.features import Features
from planspace.plan.primitives import Servo
from planspace.plan.sst import SST
from planspace.plan.sst_search import SSTSearch
from planspace.plan.tree import Tree
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem

from .test_sst import query

TWO = """<mujoco><compiler angle="radian" autolimits="true"/><option timestep="0.01" gravity="0 0 0"/>
  <worldbody><body name="first"><joint name="a" axis="0 0 1" range="-2 2" damping="0.1"/>
    <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/>
    <body name="second" pos="0.5 0 0"><joint name="b" axis="0 0 1" range="-2 2" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/></body></body></worldbody>
  <actuator><motor joint="b" gear="-5" ctrlrange="-1 1"/><position joint="a" kp="50" kv="8" ctrlrange="-2 2"/>
  </actuator></mujoco>"""


def two_links() -> tuple[Problem, Simulator]:
    problem = replace(load_problem("reacher"), model=TWO, joints=("a", "b"), settings=())
    model, space = problem.compile()
    return problem, Simulator(model, space, 16, threads=1)


def test_a_servo_drives_the_joint_of_a_motor_to_its_target() -> None:
    """The motor's gear is negative; the position servo keeps its control, which is a target already."""
    _, simulator = two_links()
    servo, rng = Servo(simulator), np.random.default_rng(0)
    assert servo.motors.tolist() == [0]
    aims = servo.draw(rng, np.tile([0.3, 0.5], (16, 1)))
    assert (aims[:, 1] == 0.5).all() and np.ptp(aims[:, 0]) > 1.0 and np.abs(aims[:, 0]).max() <= 2.0
    ends, valid, controls = servo.propagate(np.zeros((16, 4)), 0.6 * aims, np.full(16, 400), 2)
    assert valid.all()
    np.testing.assert_allclose(ends[:, :2], 0.6 * aims[:, ::-1], atol=0.05)
    assert {len(sequence) for sequence in controls} == {400}
    assert max(np.abs(sequence[:, 0]).max() for sequence in controls) <= 1.0


def test_the_path_through_edges_that_servo_is_what_was_simulated() -> None:
    problem, simulator = two_links()
    servo, tree = Servo(simulator), Tree(np.zeros(4), problem, simulator, 0.01)
    aims = servo.draw(np.random.default_rng(0), np.zeros((16, 2)))
    durations = np.arange(2, 34, 2)
    ends, _, controls = servo.propagate(np.zeros((16, 4)), aims, durations, 2)
    nodes = tree.add_servos(np.zeros(16, dtype=int), aims, controls, ends)
    assert tree.servos[nodes].all() and not tree.servos[0]
    np.testing.assert_allclose(tree.costs[nodes], 0.01 * tree.durations[nodes])
    last = int(nodes[-1])
    after = tree.add(np.array([last]), np.array([[1.0, 0.0]]), np.array([6]), ends[-1:] + 0.1)
    path = tree.path(int(after[0]))
    np.testing.assert_array_equal(path[:-6], controls[-1])
    np.testing.assert_array_equal(path[-6:], np.tile([1.0, 0.0], (6, 1)))
    data_states = simulator.states()
    simulator.reset(np.zeros((1, 4)), np.array([0], dtype=np.int32))
    for control in controls[-1]:
        simulator.step(control[None], ids=np.array([0], dtype=np.int32))
    np.testing.assert_array_equal(simulator.states()[0], data_states[-1])


def grown(config: SST, rounds: int = 4) -> tuple[SSTSearch, Tree]:
    search = query(0, config)
    tree = Tree(search.start, search.problem, search.simulator, config.witness_size)
    for _ in range(rounds):
        parents = search._select(tree, config.selection_radius)
        search._extend(tree, parents, search._draw_edges(tree, parents))
    return search, tree


def test_an_edge_may_go_on_with_the_action_before_it() -> None:
    _, tree = grown(SST(extensions=128, hold_last=1.0))
    later = np.flatnonzero(tree.parents > 0)
    assert len(later)
    np.testing.assert_array_equal(tree.controls[later], tree.controls[tree.parents[later]])
    _, tree = grown(SST(extensions=128, hold_last=1.0, servo=1.0))
    assert tree.servos[1:].all() and set(tree.sequences) == set(range(1, len(tree.costs)))


def test_greedy_selection_prefers_nodes_near_the_goal() -> None:
    search, tree = grown(SST(extensions=128), rounds=8)
    distance = search.goal.distance(tree.states)
    search.config = replace(search.config, greedy=1.0)
    chosen = distance[search._select(tree, 0.3)]
    assert np.median(chosen) < np.quantile(distance, 0.15)


def test_soft_joint_limits_may_be_exceeded_by_the_slack() -> None:
    """Only limits of the model are widened: those of joint `b`, not the narrower bounds given for `a`."""
    problem, _ = two_links()
    bounds = (("a", (-1.0,), (1.0,)),)
    _, space = replace(problem, position_bounds=bounds, limit_slack=0.25).compile()
    np.testing.assert_array_equal([space.low, space.high], [[-1.0, -2.25], [1.0, 2.25]])


def test_body_features_are_positions_in_the_world() -> None:
    """Both links along x: the second body is at 0.5 m; with the first turned by 90 degrees, at (0, 0.5)."""
    problem, simulator = two_links()
    problem = replace(problem, feature_weights=(0.0,) * 4, body_features=(("second", 2.0),))
    states = np.array([[0.0, 0.3, 1.0, 1.0], [np.pi / 2, 0.0, 0.0, 0.0]])
    found = Features(problem, simulator)(states)
    np.testing.assert_allclose(found[:, -3:], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], atol=1e-12)
    assert (found[:, :-3] == 0).all()


@pytest.mark.parametrize(("name", "value"), [("hold_last", 1.5), ("servo", -0.1), ("greedy", 2.0)])
def test_fractions_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(UsageError, match=f"`{name}` must be between 0 and 1, got {value}"):
        replace(SST(), **{name: value})
