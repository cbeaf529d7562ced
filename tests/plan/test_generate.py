import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.describe import replay_errors
from planspace.demos.folder import load_demos
from planspace.errors import PartialResult, PlanspaceError, UsageError
from planspace.plan import generate as module
from planspace.plan.generate import generate
from planspace.plan.planner import Failure, Planner, PlannerConfig
from planspace.plan.polish import PolishConfig
from planspace.plan.regulator import Regulator
from planspace.plan.sst import SSTConfig
from planspace.tasks.problem import Box
from planspace.tasks.problem_file import load_problem, shipped_problems

from ..conftest import QUICK_PLANNER


def test_interrupted_planning_ends_as_undisturbed_planning_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, planned = load_problem("cartpole-swingup"), []
    plan_one, out = module.plan_one, tmp_path / "interrupted"
    generate(problem, tmp_path / "alone", num=12, seed=0, config=QUICK_PLANNER, workers=0)

    def counted(*args: object):
        planned.append(args[-1])
        if len(planned) == 12:
            raise KeyboardInterrupt
        return plan_one(*args)  # pyright: ignore

    monkeypatch.setattr(module, "plan_one", counted)
    with pytest.raises(KeyboardInterrupt):
        generate(problem, out, num=12, seed=0, config=QUICK_PLANNER, workers=0)
    assert len(load_demos(out)) == 11  # a full shard, and the plan that was done when it was stopped
    generate(problem, out, num=12, seed=0, config=QUICK_PLANNER, workers=0)
    assert planned == [*range(12), 11]  # nothing on disk was planned again
    assert load_demos(out).hash == load_demos(tmp_path / "alone").hash


def test_plans_do_not_depend_on_the_number_of_workers(demos: Demos, tmp_path: Path) -> None:
    generate(load_problem("cartpole-swingup"), tmp_path, num=12, seed=0, config=QUICK_PLANNER, workers=3)
    assert load_demos(tmp_path).hash == demos.hash  # planned by one for each core


def test_a_finished_dataset_is_left_alone_and_other_settings_are_refused(demo_folder: Path) -> None:
    problem = load_problem("cartpole-swingup")
    before = {p.name: p.read_bytes() for p in demo_folder.iterdir()}
    generate(problem, demo_folder, num=12, seed=0, config=QUICK_PLANNER)
    assert {p.name: p.read_bytes() for p in demo_folder.iterdir()} == before
    with pytest.raises(PlanspaceError, match="other settings: seed was 0, now 7."):
        generate(problem, demo_folder, num=12, seed=7, config=QUICK_PLANNER)


def test_failed_plans_are_counted_and_the_others_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan_one, failure = module.plan_one, Failure(0.25, "no path found within the budget")
    monkeypatch.setattr(module, "plan_one", lambda *args: failure if args[-1] == 1 else plan_one(*args))
    problem = load_problem("cartpole")
    with pytest.raises(
        PartialResult, match="1 of 3 plans found no way to the goal .*came within 0.25"
    ) as raised:
        generate(problem, tmp_path, num=3, seed=0, config=QUICK_PLANNER, workers=0)
    assert raised.value.exit_code == 3
    assert load_demos(tmp_path).indices.tolist() == [0, 2]
    logged = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    expected = {"plan": 1, "nearest": 0.25, "reason": "no path found within the budget"}
    assert logged[-1]["failures"] == [expected]
    with open(tmp_path / "log.jsonl", "ab") as log:
        log.write(b'{"failures": 1}\n')
    with pytest.raises(PlanspaceError, match="log.jsonl was altered or damaged.*`planspace repair"):
        generate(problem, tmp_path, num=3, seed=0, config=QUICK_PLANNER, workers=0)


def test_an_unreachable_goal_stops_at_its_budget_and_says_how_near_it_came(tmp_path: Path) -> None:
    problem = load_problem("cartpole-swingup")
    # at rest in the middle with the pole level: no control holds it there, and no tree finds it
    level = (0.0, np.pi / 2, 0.0, 0.0)
    hanging = replace(problem, goal=Box(level, level), start=Box((0.0, 3.1, 0.0, 0.0), (0.0, 3.1, 0.0, 0.0)))
    hopeless = PlannerConfig(
        restarts=1,
        sst=SSTConfig(extensions=64, min_rounds=1, max_rounds=2),
        polish=PolishConfig(max_iterations=5),
    )
    with pytest.raises(PartialResult, match="1 of 1 plans .* The nearest came within [0-9.]+ of it"):
        generate(hanging, tmp_path, num=1, seed=0, config=hopeless, workers=0)
    with pytest.raises(PartialResult, match="1 of 1 plans .* The nearest came within"):  # said again
        generate(hanging, tmp_path, num=1, seed=0, config=hopeless, workers=0)


@pytest.mark.parametrize("name", [n for n in shipped_problems() if n != "acrobot"])
def test_every_shipped_problem_is_solved(name: str) -> None:
    problem = load_problem(name)
    config = PlannerConfig.for_problem(problem, restarts=1, polish_max_iterations=12)
    episode = module.plan_one(problem, config, 0, 0)
    assert not isinstance(episode, Failure)
    model, space = problem.compile()
    goal = replace(problem.draw_goal(space, np.random.default_rng(0)), center=episode.goal)
    assert goal.reached(episode.states[-1])
    assert not goal.reached(episode.states[:-1]).any()  # the record ends where the goal is first entered
    np.testing.assert_allclose(np.diff(episode.times), model.opt.timestep)
    info = module.state_info(problem)
    assert replay_errors(Demos.from_episodes(info, [episode])).max() <= 1e-6
    assert episode.cost == pytest.approx(episode.times[-1])


@pytest.mark.slow
def test_the_acrobot_is_solved() -> None:
    problem = load_problem("acrobot")
    config = PlannerConfig.for_problem(problem, restarts=1, polish_max_iterations=20)
    assert not isinstance(module.plan_one(problem, config, 0, 0), Failure)


def test_polish_makes_plans_shorter_and_restarts_never_longer() -> None:
    problem = load_problem("cartpole-swingup")
    lengths = {}
    for key, config in {
        "tree": PlannerConfig.for_problem(problem, polish_max_iterations=0, restarts=1),
        "one": PlannerConfig.for_problem(problem, restarts=1),
        "two": PlannerConfig.for_problem(problem, restarts=2),
    }.items():
        plans = [module.plan_one(problem, config, 0, index) for index in range(3)]
        assert not any(isinstance(plan, Failure) for plan in plans)
        lengths[key] = np.array([len(plan.controls) for plan in plans])  # pyright: ignore
    assert lengths["one"].sum() < 0.7 * lengths["tree"].sum()
    assert (lengths["two"] <= lengths["one"]).all()


def test_a_changed_setting_is_named_alone(tmp_path: Path) -> None:
    problem = load_problem("cartpole")
    generate(problem, tmp_path, num=1, seed=0, config=QUICK_PLANNER, workers=0)
    other = replace(QUICK_PLANNER, sst=SSTConfig(extensions=128))
    with pytest.raises(PlanspaceError, match="settings: config.sst.extensions was 256, now 128.$"):
        generate(problem, tmp_path, num=1, seed=0, config=other, workers=0)


def test_a_start_in_the_goal_region_is_drawn_again() -> None:
    problem = load_problem("pendulum")
    near = replace(problem, start=Box((-0.2, 0.0), (0.2, 0.0)))  # half of them are within 0.1
    planner = Planner(near, PlannerConfig.for_problem(near, restarts=1))
    for index in range(4):
        plan = planner.plan(0, index)
        assert not isinstance(plan, Failure) and plan.seed == 0 and abs(plan.states[0, 0]) > 0.1
    rng = np.random.default_rng(0)
    inside = planner.connect(np.zeros(2), near.draw_goal(planner.space, rng), rng)
    assert isinstance(inside, Failure) and inside.reason == "the start lies in the goal region"


def test_holding_must_not_leave_what_is_valid() -> None:
    """A cart that arrives at the wall too fast: it comes back into the goal, but through the wall."""
    wall = """<mujoco><worldbody>
      <body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body></worldbody>
      <actuator><motor joint="x" ctrllimited="true" ctrlrange="-20 20"/></actuator></mujoco>"""
    problem = replace(
        load_problem("pendulum"), mjcf=wall, joints=("x",), start=Box((0.0, 0.0), (0.0, 0.0)),
        goal=Box((0.95, 0.0), (0.95, 0.0)), goal_weights=(1.0, 0.0), tolerance=0.05,
        position_bounds=(("x", (-1.0,), (1.0,)),), sample_velocity=(5.0,),
    )  # fmt: skip
    planner = Planner(problem, PlannerConfig.for_problem(problem))
    goal = problem.draw_goal(planner.space, np.random.default_rng(0))
    regulator = Regulator(planner.simulator, goal, planner.weights, planner.config.regulator)
    fast = np.full((250, 1), 20.0)  # at 20 m/s^2 it is 6 m/s fast after 0.9 m
    assert "cannot be held" in str(planner.record(regulator, np.zeros(2), fast))
    brakes = np.concatenate([np.full((215, 1), 5.0), np.full((215, 1), -5.0)])  # at rest after 0.92 m
    found = planner.record(regulator, np.zeros(2), brakes)
    assert not isinstance(found, str), found


def test_a_predicate_needs_a_name_by_which_workers_find_it(tmp_path: Path) -> None:
    problem = replace(load_problem("cartpole"), predicate=lambda x: np.ones(len(x), dtype=bool))
    with pytest.raises(UsageError, match="must be a function that its module has by name, not a lambda"):
        generate(problem, tmp_path / "demos", num=1, seed=0)
    assert not (tmp_path / "demos").exists()


def test_a_goal_that_need_not_be_held_can_be_run_through() -> None:
    """The pole level and moving: no control holds it, so with `hold` nothing is accepted."""
    problem = load_problem("cartpole-swingup")
    through = (0.0, 1.57, 0.0, -3.0)
    moving = replace(problem, goal=Box(through, through), goal_weights=(0.2, 1.0, 0.2, 0.2), tolerance=0.2)
    config = PlannerConfig.for_problem(moving, restarts=1, max_rounds=40)
    held = module.plan_one(moving, config, 0, 0)
    assert isinstance(held, Failure) and "cannot be held" in held.reason
    assert not isinstance(module.plan_one(replace(moving, hold=False), config, 0, 0), Failure)


def test_rotations_are_stored_with_one_sign_and_an_end_of_positive_w() -> None:
    problem = load_problem("ball-pendulum")
    episode = module.plan_one(problem, PlannerConfig.for_problem(problem, restarts=1), 0, 1)
    assert not isinstance(episode, Failure)
    q = episode.states[:, :4]
    assert (np.einsum("ti,ti->t", q[1:], q[:-1]) > 0.9).all() and q[-1, 0] > 0
