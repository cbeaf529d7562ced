"""What a failed search says."""

from dataclasses import replace

import numpy as np
import pytest

from planspace.physics.simulator import Simulator
from planspace.plan.config import RegulatorConfig
from planspace.plan.planner import Failure
from planspace.plan.query import Query
from planspace.plan.regulator import Regulator
from planspace.plan.sst import SST
from planspace.tasks.problem import Box, Problem

SLED = """<mujoco><option timestep="0.02" gravity="0 0 0"/><worldbody>
  <geom name="wall" type="box" size="0.1 1 1" pos="0.5 0 0"/>
  <body><joint name="x" type="slide" axis="1 0 0" range="-{range} 2"/>
    <geom name="sled" size="0.1" mass="1"/></body>
</worldbody><actuator><motor joint="x" ctrlrange="{least} 5"/></actuator></mujoco>"""


def fail(*, least: float = -5.0, reach: float = 0.1, **more: object) -> Failure:
    """Search for a way through the wall."""
    problem = Problem(
        "sled", SLED.format(range=reach, least=least), ("x",), Box((0.0, 0.0), (0.0, 0.0)),
        Box((1.0, 0.0), (1.0, 0.0)), 0.1, forbidden_contacts=(("sled", "wall"),),
    )  # fmt: skip
    problem = replace(problem, **more)
    model, space = problem.compile()
    simulator = Simulator(model, space, 256, threads=1, validity=problem.validity)
    rng = np.random.default_rng(0)
    goal = problem.draw_goal(space, rng)
    regulator = Regulator(simulator, goal, problem.weights(space), RegulatorConfig())
    query = Query(problem, np.zeros(2), goal, simulator, regulator)
    found = SST(extensions=256, max_rounds=8).plan(query, rng)
    assert isinstance(found, Failure)
    return found


@pytest.mark.parametrize(
    ("settings", "cause"),
    [
        ({"least": 4.0}, "touch a forbidden contact or fail the predicate"),
        ({"least": -50.0}, "leave the range of x"),
        ({"velocity_bound": (0.2,), "reach": 5.0}, "exceed the velocity_bound of xvel, 0.2"),
    ],
)
def test_the_main_cause_is_named(settings: dict[str, object], cause: str) -> None:
    reason = fail(**settings).reason  # pyright: ignore
    assert reason.startswith("no path found within the budget: the tree has ")
    assert cause in reason
    assert ("limit_slack accepts soft joint limits" in reason) == cause.startswith("leave the range")


def test_a_small_tree_suggests_longer_edges() -> None:
    assert "longer edges (max_edge_s) or a lower sample_velocity may help" in fail().reason
