from dataclasses import replace
from pathlib import Path

import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.assets import ASSETS
from planspace.tasks.catalog import find_task
from planspace.tasks.problem import Box
from planspace.tasks.problem_file import load_problem


def test_a_quaternion_of_length_zero_is_refused() -> None:
    problem = load_problem("quadrotor")
    first = problem.compile()[1].quaternion_columns[0]
    goal = (*problem.goal.low[:first], 0.0, 0.0, 0.0, 0.0, *problem.goal.low[first + 4 :])
    with pytest.raises(PlanspaceError, match="goal: '.*' begins a quaternion of length 0"):
        load_problem(replace(problem, goal=Box(goal, goal)))


def test_a_name_without_its_ending_suggests_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for file in ("cartpole.xml", "cartpole-swingup.yaml"):
        (tmp_path / file.replace("cartpole-swingup", "mine")).write_text((ASSETS / file).read_text())
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="Did you mean the problem file mine.yaml"):
        load_problem("mine")
    with pytest.raises(UsageError, match=r"cartpole.xml is not a problem file: its name should end in .yaml"):
        find_task("cartpole.xml")


def test_an_empty_file_is_said_to_be_empty(tmp_path: Path) -> None:
    (tmp_path / "empty.yaml").write_text("# soon\n")
    with pytest.raises(PlanspaceError, match=r"empty.yaml is empty; it must hold keys and values"):
        load_problem(tmp_path / "empty.yaml")
