from pathlib import Path

import numpy as np
import pytest

from planspace.demos.load import load_demos
from planspace.errors import PlanspaceError
from planspace.physics.replay import replay
from planspace.study.plans_2020 import MAX_STEPS, distance_of_2020, winding_plans
from planspace.tasks.problem_file import load_problem

GOAL = np.zeros(4)


@pytest.mark.parametrize(
    ("theta", "expected"),
    [(1.0, 1.0), (np.pi, np.pi), (2 * np.pi - 1, 1.0), (2 * np.pi, 0.0), (2 * np.pi + 3, -3.0), (-9.0, None)],
)
def test_the_distance_of_2020_is_negative_beyond_a_rotation(theta: float, expected: float | None) -> None:
    expected = 2 * np.pi - 9.0 if expected is None else expected
    assert distance_of_2020(np.array([0.0, theta, 0.0, 0.0]), GOAL) == pytest.approx(expected)
    # the other differences add up: 0.5 + 2 + 1
    moving = np.array([0.5, theta, -2.0, 1.0])
    assert distance_of_2020(moving, GOAL) == pytest.approx(expected + 3.5)


@pytest.mark.nightly
def test_plans_with_winding_reach_the_goal_only_by_the_distance_of_2020(tmp_path: Path) -> None:
    problem = load_problem("cartpole-swingup")
    winding_plans(problem, tmp_path / "demos", 3, seed=0)
    demos = load_demos(tmp_path / "demos")
    model, space = demos.info.compile()
    assert np.abs(demos.controls).max() <= 1.0 and not demos.success.any()
    for i in range(3):
        episode = demos.episode(i)
        assert distance_of_2020(episode.states[-1], GOAL) <= problem.tolerance
        assert (np.abs(episode.states[:-1, 1]) < np.abs(episode.states[-1, 1]) + 1.0).all()
        assert abs(episode.states[-1, 1]) > 2 * np.pi
        assert space.distance(episode.states[-1:], episode.goal[None])[0] > 1.0  # far from the goal
        assert 20 < len(episode.controls) <= MAX_STEPS + 10
        again = replay(model, space, episode.states[0], episode.controls, episode.times)
        np.testing.assert_allclose(again, episode.states, atol=1e-9)
    winding_plans(problem, tmp_path / "demos", 3, seed=0)  # nothing left to do
    assert load_demos(tmp_path / "demos").hash == demos.hash


def test_only_the_swing_up_has_plans_with_winding(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="exist only for cartpole-swingup, got reacher"):
        winding_plans(load_problem("reacher"), tmp_path / "demos", 1, seed=0)
