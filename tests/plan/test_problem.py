from pathlib import Path

import numpy as np
import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.physics.simulate import ASSETS
from planspace.plan.problem import load_problem, shipped_problems

GOOD = (ASSETS / "cartpole-swingup.yaml").read_text()


def write(folder: Path, text: str) -> str:
    (folder / "cartpole.xml").write_text((ASSETS / "cartpole.xml").read_text())
    path = folder / "mine.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize("name", shipped_problems())
def test_shipped_problems_load_and_start_in_bounds(name: str, rng: np.random.Generator) -> None:
    problem = load_problem(name)
    _, space = problem.compile()
    starts = np.stack([problem.start.sample(rng) for _ in range(100)])
    assert space.in_bounds(starts).all()


def test_a_file_is_the_same_problem_under_another_name(tmp_path: Path) -> None:
    mine, shipped = load_problem(write(tmp_path, GOOD)), load_problem("cartpole-swingup")
    assert mine.name == "mine"
    assert (mine.mjcf, mine.start, mine.goal) == (shipped.mjcf, shipped.start, shipped.goal)


def test_a_random_goal_is_drawn_from_its_box(rng: np.random.Generator) -> None:
    goal = load_problem("reacher-random").goal
    drawn = np.stack([goal.sample(rng) for _ in range(50)])
    assert drawn[:, :2].std(axis=0).min() > 1.0
    assert (drawn[:, 2:] == 0).all()


def test_an_unknown_problem_suggests_the_nearest() -> None:
    with pytest.raises(
        UsageError, match="unknown problem 'cartpole-swngup'. Did you mean 'cartpole-swingup'"
    ):
        load_problem("cartpole-swngup")


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("tolerance:", "tolerence:", "unknown key 'tolerence'. Did you mean 'tolerance'"),
        ("tolerance: 0.1", "", "the key 'tolerance' is missing"),
        ("[slider, hinge]", "[slider, hing]", "unknown joint 'hing'. Did you mean 'hinge'"),
        ("model: cartpole.xml", "model: nowhere.xml", "cannot read .*nowhere.xml"),
        ("goal: [0.0, 0.0, 0.0, 0.0]", "goal: [0.0, 0.0]", "goal has 2 numbers, the state needs 4"),
        ("goal: [0.0,", "goal: [2.0,", "goal reaches outside the joint limits"),
        ("low: [-0.2,", "low: [0.9,", "a box needs low <= high"),
        ("goal: [0.0, 0.0, 0.0, 0.0]", "goal: up", "expected a list of numbers, got 'up'"),
        ("tolerance: 0.1", "tolerance: !!python/object/apply:os.getcwd []", "is not valid YAML"),
        ("tolerance: 0.1", "tolerance: [", "is not valid YAML"),
    ],
)
def test_bad_files_are_refused(before: str, after: str, message: str, tmp_path: Path) -> None:
    assert before in GOOD
    with pytest.raises(PlanspaceError, match=message):
        load_problem(write(tmp_path, GOOD.replace(before, after)))
