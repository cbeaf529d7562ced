"""A planner that a user wrote, used through API and command line, beside a shipped one.

The problem is a double integrator: a mass of 1 kg without friction and a force of at most 10 N. From rest to
rest over a distance d it takes at least 2 sqrt(d / 10): half of the way accelerating, half braking. A plan
ends as soon as |x| + |v| <= 0.1, which is fastest at rest 0.1 m before the goal.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planspace as ps
from planspace.cli import main
from planspace.errors import UsageError
from planspace.plan import Failure, Plan, PlanConfig
from planspace.plan.ompl.planners import OMPL

from . import bang_bang
from .bang_bang import BangBang

MODEL = """<mujoco><option timestep="0.02" gravity="0 0 0"/><worldbody>
  <body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body></worldbody>
  <actuator><motor joint="x" gear="10" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""
PROBLEM = """model: mass.xml
joints: [x]
start: {low: [-1.0, 0.0], high: [1.0, 0.0]}
goal: [0.0, 0.0]
tolerance: 0.1
velocity_bound: 5
position_bounds: {x: {low: [-2.0], high: [2.0]}}
"""
ACCELERATION, STEP, TOLERANCE = 10.0, 0.02, 0.1
PAGE = "See docs/howto/own-planner.md."


@pytest.fixture(scope="module")
def problem_file(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("problem")
    (folder / "mass.xml").write_text(MODEL)
    (folder / "mass.yaml").write_text(PROBLEM)
    return str(folder / "mass.yaml")


@pytest.fixture(scope="module")
def problem(problem_file: str) -> ps.Problem:
    return ps.load_problem(problem_file)


def extra_steps(demos: ps.Demos) -> np.ndarray:
    """Duration of each plan beyond the shortest possible from its start, in physics steps."""
    starts, ends = demos.states[demos.offsets[:-1]], demos.offsets[1:] - 1
    distances = np.abs(starts[:, 0]) - TOLERANCE
    return (demos.times[ends] - 2 * np.sqrt(distances / ACCELERATION)) / STEP


@pytest.mark.slow
def test_a_users_planner_and_the_shipped_one_take_the_shortest_time(problem: ps.Problem) -> None:
    own = ps.plan_demos(problem, 4, planner=BangBang(), workers=0, verbose=False)
    shipped = ps.plan_demos(problem, 4, planner="sst", workers=0, verbose=False)
    for demos in (own, shipped):
        extra = extra_steps(demos)
        assert extra.min() >= 0 and extra.max() < 1, extra  # the shortest time, rounded up to a whole step
    np.testing.assert_array_equal(own.states[own.offsets[:-1]], shipped.states[shipped.offsets[:-1]])


def test_without_polish_the_path_is_stored_as_the_planner_returned_it(problem: ps.Problem) -> None:
    unpolished = PlanConfig.for_problem(problem, polish_max_iterations=0)
    demos = ps.plan_demos(problem, 2, planner=BangBang(), config=unpolished, workers=0, verbose=False)
    assert (np.abs(demos.controls) == 1.0).all()  # bang-bang
    extra = extra_steps(demos)
    assert extra.min() >= 0 and extra.max() < 7, (
        extra
    )  # the unpolished plan continues to the middle of the goal region


def test_a_function_is_a_planner_too(problem: ps.Problem) -> None:
    function = ps.plan_demos(problem, 1, planner=bang_bang.bang_bang, workers=0, verbose=False)
    assert function.hash == ps.plan_demos(problem, 1, planner=BangBang(), workers=0, verbose=False).hash


@pytest.mark.slow
def test_the_command_line_takes_a_planner_from_a_file(
    problem_file: str, problem: ps.Problem, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    planner = f"{Path(bang_bang.__file__)}:BANG_BANG"
    options = ["--planner", planner, "--max-steps", "900", "--num", "3", "--workers", "2"]
    assert main(["plan", problem_file, *options, "--out", str(tmp_path / "demos")]) == 0
    assert "3 demonstrations" in capsys.readouterr().out
    expected = ps.plan_demos(problem, 3, planner=BangBang(max_steps=900), workers=1, verbose=False)
    assert ps.load_demos(tmp_path / "demos").hash == expected.hash
    with pytest.raises(ps.PlanspaceError, match=r"config\.planner\.max_steps was 900, now 800"):
        ps.plan_demos(problem, 3, planner=BangBang(max_steps=800), out=tmp_path / "demos", workers=0)


@dataclass(frozen=True)
class Returns:
    """A planner that returns the same in every search."""

    found: Any

    def plan(self, query: Any, rng: Any) -> Any:
        return self.found


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (np.zeros((3, 1)), r"plan\(\) must return a Plan or a Failure, got array.*"),
        (None, r"plan\(\) must return a Plan or a Failure, got None\."),
        (Plan(np.zeros((3, 2))), r"must return controls of shape \(number of physics steps, 1\), got shape "),
        (Plan(np.array([[0.0], [np.nan]])), "must return finite controls, got nan in step 1, number 0"),
        (Plan(np.array([[0.5], [1.5]])), r"controls between \[-1.0\] and \[1.0\], got 1.5 in step 1"),
        (Failure("far", 0.5, np.zeros((3, 2))), r"must return controls of shape .* got shape \(3, 2\)"),
    ],
)
def test_the_first_result_of_a_planner_is_checked(problem: ps.Problem, found: Any, message: str) -> None:
    with pytest.raises(UsageError, match=f"Planner {__name__}:Returns: .*{message}.*{PAGE}"):
        ps.plan_demos(problem, 1, planner=Returns(found), workers=0, verbose=False)


@pytest.mark.slow
def test_errors_of_the_check_in_a_worker_process_are_raised(problem: ps.Problem, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="must return a Plan or a Failure, got 'a path'") as raised:
        ps.plan_demos(problem, 3, planner=Returns("a path"), workers=2, out=tmp_path / "d", verbose=False)
    assert raised.value.exit_code == 2
    assert not list((tmp_path / "d").iterdir())  # nothing was stored


class Searcher:
    def search(self) -> None: ...


@pytest.mark.parametrize(
    ("planner", "message"),
    [
        (BangBang, "expected a Planner, got the class BangBang: pass an instance."),
        (Searcher(), "A Planner needs the method plan; .*Searcher.* has no plan."),
        (3, "A Planner needs the method plan; 3 has no plan."),
    ],
)
def test_objects_that_are_not_planners_are_refused(problem: ps.Problem, planner: Any, message: str) -> None:
    with pytest.raises(UsageError, match=f"{message} {PAGE}"):
        ps.plan_demos(problem, 1, planner=planner)
    with pytest.raises(UsageError, match=f"{message} {PAGE}"):
        PlanConfig.for_problem(problem, planner=planner)


def test_an_unknown_name_is_refused_with_a_suggestion(problem: ps.Problem) -> None:
    with pytest.raises(UsageError, match="unknown planner 'ompl-rtt'. Did you mean 'ompl-rrt'"):
        ps.plan_demos(problem, 1, planner="ompl-rtt")


class Picky(Searcher):
    """A planner with the optional method `check`."""

    def plan(self, query: Any, rng: Any) -> Failure:
        return Failure("never called")

    def check(self, problem: ps.Problem) -> None:
        raise UsageError(f"no force in {problem.name} is large enough.")


def test_a_planner_may_refuse_a_problem_before_anything_is_written(
    problem: ps.Problem, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="no force in mass is large enough"):
        ps.plan_demos(problem, 1, planner=Picky(), out=tmp_path / "demos")
    with pytest.raises(UsageError, match="ompl-prm cannot plan a dynamic problem"):
        ps.plan_demos(problem, 1, planner=OMPL("PRM"), out=tmp_path / "demos")
    assert not (tmp_path / "demos").exists()


@pytest.mark.slow
def test_a_planner_whose_module_a_worker_cannot_import_is_refused(
    problem: ps.Problem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone.py").write_text("class Own:\n    def plan(self, query, rng): ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    import gone  # pyright: ignore[reportMissingImports]

    (tmp_path / "gone.py").unlink()
    with pytest.raises(UsageError, match="worker processes cannot import the planner: .*'gone'"):
        ps.plan_demos(problem, 1, planner=gone.Own(), workers=1, verbose=False)


def test_failed_plans_give_a_warning_and_the_others_are_returned(problem: ps.Problem) -> None:
    config = PlanConfig.for_problem(problem, planner=BangBang(max_steps=24), polish_max_iterations=0)
    with pytest.warns(UserWarning, match=r"\d of 8 plans found no way to the goal .* came within"):
        demos = ps.plan_demos(problem, 8, config=config, workers=0, verbose=False)
    assert 0 < len(demos) < 8
    with pytest.raises(ps.PartialResult, match="1 of 1 plans found no way"):
        ps.plan_demos(problem, 1, planner=Returns(Failure("too far")), workers=0, verbose=False)
