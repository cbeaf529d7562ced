from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos, load_demos
from planspace.errors import PartialResult, PlanspaceError
from planspace.plan import generate as module
from planspace.plan.generate import PlannerConfig, generate
from planspace.plan.problem import Box, load_problem
from planspace.plan.sst import SSTConfig

from ..conftest import QUICK_PLANNER


def test_interrupted_serial_planning_ends_as_undisturbed_parallel_planning_did(
    demos: Demos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, planned = load_problem("cartpole-swingup"), []
    plan_one = module.plan_one

    def counted(*args: object):
        planned.append(args[-1])
        if len(planned) == 12:
            raise KeyboardInterrupt
        return plan_one(*args)  # pyright: ignore

    monkeypatch.setattr(module, "plan_one", counted)
    with pytest.raises(KeyboardInterrupt):
        generate(problem, tmp_path, num=12, seed=0, config=QUICK_PLANNER, workers=1)
    assert len(load_demos(tmp_path)) == 10  # the shard that was full is safe
    generate(problem, tmp_path, num=12, seed=0, config=QUICK_PLANNER, workers=1)
    assert planned == [*range(12), 10, 11]  # nothing on disk was planned again
    assert load_demos(tmp_path).hash == demos.hash


def test_a_finished_dataset_is_left_alone_and_other_settings_are_refused(demo_folder: Path) -> None:
    problem = load_problem("cartpole-swingup")
    before = {p.name: p.read_bytes() for p in demo_folder.iterdir()}
    generate(problem, demo_folder, num=12, seed=0, config=QUICK_PLANNER)
    assert {p.name: p.read_bytes() for p in demo_folder.iterdir()} == before
    with pytest.raises(PlanspaceError, match="other settings: seed was 0, now 7"):
        generate(problem, demo_folder, num=12, seed=7, config=QUICK_PLANNER)


def test_failed_plans_are_counted_and_the_others_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan_one = module.plan_one
    monkeypatch.setattr(module, "plan_one", lambda *args: None if args[-1] == 1 else plan_one(*args))
    problem = load_problem("cartpole")
    with pytest.raises(PartialResult, match="1 of 3 plans found no way to the goal") as raised:
        generate(problem, tmp_path, num=3, seed=0, config=QUICK_PLANNER, workers=1)
    assert raised.value.exit_code == 3
    assert load_demos(tmp_path).indices.tolist() == [0, 2]


def test_an_unreachable_goal_fails_after_its_attempts() -> None:
    far = load_problem("cartpole-swingup")
    hopeless = PlannerConfig(sst=SSTConfig(extensions=8, min_rounds=1, max_rounds=1))
    hanging = replace(far, start=Box((0.0, 3.1, 0.0, 0.0), (0.0, 3.1, 0.0, 0.0)))
    assert module.plan_one(hanging, hopeless, 0, 0) is None


@pytest.mark.parametrize("name", ["cartpole", "reacher", "reacher-random"])
def test_every_shipped_problem_is_solved(name: str) -> None:
    problem = load_problem(name)
    episode = module.plan_one(problem, QUICK_PLANNER, 0, 0)
    assert episode is not None
    _, space = problem.compile()
    assert space.distance(episode.states[-1], episode.goal) <= problem.tolerance
    before_last = space.distance(episode.states[:-1], episode.goal)
    assert (before_last > problem.tolerance).all()  # the record ends where the goal is first entered
    np.testing.assert_allclose(np.diff(episode.times), problem.compile()[0].opt.timestep)
