"""Settings of planning, from problem files and from Python."""

from dataclasses import dataclass, replace
from typing import Any

import pytest

from planspace.errors import UsageError
from planspace.plan.config import PlanConfig, PolishConfig, RegulatorConfig
from planspace.plan.ompl.planners import OMPL
from planspace.plan.planner import Failure
from planspace.plan.sst import SST
from planspace.tasks.problem_file import load_problem


@dataclass(frozen=True)
class Own:
    step: float = 0.1
    tries: int = 3
    label: str = "a"

    def plan(self, query: Any, rng: Any) -> Failure:
        return Failure("not written yet")


def test_settings_reach_the_parts_they_name() -> None:
    problem = replace(load_problem("cartpole"), settings=(("min_rounds", 9), ("polish_max_blocks", 50)))
    config = PlanConfig.for_problem(problem, restarts=3, ompl_seconds=None)
    assert config == PlanConfig(SST(min_rounds=9), 3, PolishConfig(max_blocks=50))
    wider = PlanConfig.for_problem(problem, min_edge_s=0.5, sst_max_edge_s=1.0)
    assert wider.planner == SST(min_rounds=9, min_edge_s=0.5, max_edge_s=1.0)
    assert PlanConfig.for_problem(problem, restarts=4.0).restarts == 4


def test_settings_in_physics_steps_are_read_as_seconds() -> None:
    """Problem files of version 0.1.0 have them; the cart-pole's time step is 0.02 s."""
    old = {
        "max_edge_steps": 20,
        "sst_min_edge_steps": 2,
        "regulator_max_steps": 150,
        "ompl_max_edge_steps": 5,
    }
    config = PlanConfig.for_problem(replace(load_problem("cartpole"), settings=tuple(old.items())))
    assert config.planner == SST(min_edge_s=0.04, max_edge_s=0.4)
    assert config.regulator == RegulatorConfig(max_s=3.0)
    with pytest.raises(UsageError, match="`ompl_min_edge_s` must be above 0 and at most .*, 0.1"):
        PlanConfig.for_problem(load_problem("cartpole"), ompl_max_edge_steps=5, ompl_min_edge_steps=6)


def test_settings_of_other_planners_are_checked_and_not_used() -> None:
    problem = replace(load_problem("pendulum"), settings=(("goal_bias", 0.5), ("ompl_goal_bias", 0.3)))
    assert PlanConfig.for_problem(problem).planner == SST(goal_bias=0.5)
    assert PlanConfig.for_problem(problem, planner="ompl-est").planner == OMPL("EST", goal_bias=0.3)
    with pytest.raises(UsageError, match="`ompl_seconds` must be above 0, got"):
        PlanConfig.for_problem(problem, ompl_seconds=-1)


def test_a_planner_that_is_not_shipped_takes_its_own_settings() -> None:
    problem = replace(load_problem("pendulum"), settings=(("witness_size", 0.3), ("step", 0.2)))
    config = PlanConfig.for_problem(problem, planner=Own(tries=5), polish_landing=0.5)
    assert config == PlanConfig(Own(0.2, 5), polish=PolishConfig(landing=0.5))
    with pytest.raises(UsageError, match="unknown setting 'step'"):  # SST has no such setting
        PlanConfig.for_problem(problem)
    with pytest.raises(UsageError, match="setting 'label' is not a number"):
        PlanConfig.for_problem(problem, planner=Own(), label=3)


def test_number_of_searches() -> None:
    assert PlanConfig().num_searches == 2
    assert PlanConfig(OMPL("RRT")).num_searches == PlanConfig(Own()).num_searches == 1
    assert PlanConfig(Own(), restarts=4).num_searches == 4


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"restarts": 0}, "settings: `restarts` must be at least 1, got 0"),
        ({"goal_bias": 2}, "settings: .*must"),
        ({"tail_every": 0}, "settings: .*must"),
        ({"witness_size": 0}, "settings: .*must"),
        ({"seconds": -1}, "settings: .*must"),
        ({"polish_max_blocks": 0}, "settings: .*polish_max_blocks.*must"),
        ({"polish_landing": 0}, "settings: .*polish_landing.*must"),
        ({"regulator_max_s": 0}, "settings: .*regulator_max_s.*must"),
        ({"ompl_seconds": 0}, "settings: .*ompl_seconds.*must"),
        ({"min_round": 3}, "unknown setting 'min_round'. Did you mean 'sst_min_rounds'"),
        ({"min_rounds": 4.5}, "'min_rounds' takes an integer, got 4.5"),
        ({"min_rounds": "many"}, "'min_rounds' takes a number, got 'many'"),
        ({"planner": "ompl-rtt"}, "unknown planner 'ompl-rtt'. Did you mean 'ompl-rrt'"),
        ({"ompl_algorithm": 1}, "setting 'ompl_algorithm' is not a number"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        PlanConfig.for_problem(load_problem("cartpole"), **settings)
