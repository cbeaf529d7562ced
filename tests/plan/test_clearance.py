import numpy as np
import pytest

from planspace.mjcf.compile import load_model
from planspace.physics.simulator import Simulator
from planspace.plan import clearance as module
from planspace.plan.clearance import REACH, Clearance, collidable_pairs
from planspace.tasks.problem_file import load_problem


@pytest.fixture(scope="module")
def clearance() -> Clearance:
    problem = load_problem("arm-kinematic")
    return Clearance(problem, problem.compile()[1], threads=1)


def test_distances_are_zero_where_contacts_begin(clearance: Clearance, rng: np.random.Generator) -> None:
    """MuJoCo computes contacts and distances separately: they must agree."""
    problem = load_problem("arm-kinematic")
    model, space = problem.compile()
    states = space.sample(rng, 400, np.ones(7))
    simulator = Simulator(model, space, 400, threads=1, validity=problem.validity)
    touching = ~simulator.valid_states(states)
    distances = clearance.distances(states)
    nearest = distances.min(axis=1)
    assert 20 < touching.sum() < 380
    assert (nearest[touching] <= 1e-6).all() and (nearest[~touching] >= -1e-6).all()
    assert distances.max() == pytest.approx(REACH)


def test_slopes_predict_small_changes(clearance: Clearance, rng: np.random.Generator) -> None:
    space = load_problem("arm-kinematic").compile()[1]
    states = space.sample(rng, 200, np.ones(7))
    before = clearance.distances(states)
    near = ((before > 0.01) & (before < 0.05)).any(axis=1)  # close, but without contact
    states, before = states[near], before[near]
    slopes = clearance.slopes(states, before)
    move = rng.normal(0, 1e-4, states.shape)
    change = clearance.distances(states + move) - before
    predicted = np.einsum("spd,sd->sp", slopes, move)
    apart = (before > 0.01) & (before < 0.05)
    assert apart.sum() > 5
    assert np.median(np.abs(change - predicted)[apart]) < 0.02 * np.abs(change[apart]).max()


def test_too_many_pairs_are_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_PAIRS", 3)
    problem = load_problem("arm-kinematic")
    clearance = Clearance(problem, problem.compile()[1], threads=1)
    states = np.array([problem.goal.low])
    assert clearance.distances(states).shape == (1, 0)
    assert clearance.slopes(states, clearance.distances(states)).shape == (1, 0, 7)


def test_pairs_that_can_collide() -> None:
    model = load_model("""<mujoco><worldbody>
      <geom name="floor" type="plane" size="1 1 1"/><geom name="wall" type="box" size="1 1 1"/>
      <body name="a"><joint type="slide"/><geom name="a1" size="0.1"/><geom name="a2" size="0.1"/>
        <body name="b"><joint type="slide"/><geom name="b" size="0.1"/>
          <body name="c"><joint type="slide"/><geom name="c" size="0.1"/>
            <geom name="ghost" size="0.1" contype="0" conaffinity="0"/></body></body></body>
    </worldbody><contact><exclude body1="c" body2="world"/></contact></mujoco>""")
    expected = {(g, x) for g in ("floor", "wall") for x in ("a1", "a2", "b")} | {("a1", "c"), ("a2", "c")}
    assert (
        set(collidable_pairs(model)) == expected
    )  # without a-b and b-c, which are parent and child, and c-world, which is excluded
