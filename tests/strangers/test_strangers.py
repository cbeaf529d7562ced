"""Four files of a stranger, used through the Python API and the command line like what is shipped."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import planspace as ps
from planspace.cli import main

from .cross_entropy import CrossEntropy
from .full_force import FullForce
from .own_objective import midpoint_loss
from .push_cart import FASTEST_S, MODEL, PROBLEM, TASK

HERE = Path(__file__).parent
STEP_S = 0.02
MOST_LINES = 80


@pytest.fixture
def problem(tmp_path: Path) -> Path:
    (tmp_path / "push_cart.xml").write_text(MODEL)
    (tmp_path / "push.yaml").write_text(PROBLEM)
    return tmp_path / "push.yaml"


def run(*arguments: object) -> None:
    assert main([str(a) for a in arguments]) == 0


def test_each_file_is_short_and_nothing_in_the_package_knows_it() -> None:
    names = [f.stem for f in HERE.glob("*.py") if f.stem not in ("__init__", "test_strangers")]
    assert len(names) == 4
    source = "\n".join(f.read_text() for f in Path(ps.__file__).parent.rglob("*.py"))
    for name in names:
        assert len((HERE / f"{name}.py").read_text().splitlines()) < MOST_LINES
        assert name not in source


def test_a_planner_is_as_fast_as_the_shipped_one_and_as_theory_says(problem: Path) -> None:
    own = ps.plan_demos(str(problem), 1, planner=FullForce(), workers=0, verbose=False)
    shipped = ps.plan_demos(str(problem), 1, planner="sst", workers=0, verbose=False)
    for demos in (own, shipped):  # a plan ends when it enters the goal region, some steps before the middle
        assert FASTEST_S - 0.25 <= demos.times[-1] <= FASTEST_S + 0.1
    assert abs(own.times[-1] - shipped.times[-1]) <= 2 * STEP_S
    slow = ps.plan_demos(str(problem), 1, planner=FullForce(force=0.25), workers=0, verbose=False)
    assert slow.times[-1] == pytest.approx(own.times[-1], abs=2 * STEP_S)  # polishing shortens it, too


def test_a_task_pays_what_its_functions_say() -> None:
    env = ps.make_env(TASK)
    env.reset(seed=0)
    idle = sum(float(env.step(np.zeros(1))[1]) for _ in range(TASK.horizon))
    assert idle == -40.0  # 40 steps at |x| = 1
    env.reset(seed=0)
    pushes = np.repeat([1.0, -1.0, 0.0], [10, 10, 20])[:, None]
    best = sum(float(env.step(push)[1]) for push in pushes)
    # the integral of |x| is 1 - 1/6 + 1/6 = 1 s; paid after each step of 0.1 s, half a step late: -10 + 0.5
    assert best == pytest.approx(-9.5, abs=0.2)


@pytest.mark.slow
def test_an_algorithm_learns_the_task_as_the_shipped_one_does() -> None:
    config = replace(ps.TrainConfig(), num_seeds=2, steps=40_000, batch_steps=2000, eval_every=0)
    own = ps.train_policies(TASK, config, algorithm=CrossEntropy(), verbose=False)
    shipped = ps.train_policies(TASK, config, algorithm="trpo", verbose=False)
    for trained in (own, shipped):  # idle -40, best -9.5
        assert max(row.evaluation for row in trained.returns) > -20


@pytest.mark.slow
def test_an_objective_gives_what_the_shipped_one_with_the_same_loss_gives(demos: ps.Demos) -> None:
    config = replace(ps.FitConfig(), steps=60, batch=32, hidden=(16, 16))
    own = ps.fit_embedding(demos, midpoint_loss, config=config, num_seeds=1, verbose=False)
    shipped = ps.fit_embedding(demos, "direct", config=config, num_seeds=1, verbose=False)
    np.testing.assert_allclose(own.encode(demos.states), shipped.encode(demos.states), atol=1e-3)


@pytest.mark.slow
def test_the_command_line_takes_all_four(problem: Path, tmp_path: Path) -> None:
    demos, embedding, policy = (tmp_path / name for name in ("demos", "embedding", "policy"))
    planner = HERE / "full_force.py"
    wide = problem.with_name("wide.yaml")
    wide.write_text(PROBLEM.replace("start: [-1.0, 0.0]", "start: {low: [-1.8, 0.0], high: [-0.5, 0.0]}"))
    run("plan", wide, "--planner", f"{planner}:PLANNER", "--force", 0.9, "--num", 12, "--out", demos)
    settings = json.loads((demos / "manifest.json").read_text())["settings"]
    assert settings["planner"] == "full-force" and settings["config"]["planner"]["force"] == 0.9
    objective = f"{HERE / 'own_objective.py'}:contrast"
    run(
        "embed",
        demos,
        "--objective",
        objective,
        "--margin",
        2.0,
        "--steps",
        30,
        "--seeds",
        1,
        "--out",
        embedding,
    )
    saved = json.loads((embedding / "config.json").read_text())["fit"]["objective"]
    assert saved["margin"] == 2.0
    task, algorithm = f"{HERE / 'push_cart.py'}:TASK", f"{HERE / 'cross_entropy.py'}:ALGORITHM"
    train = ["train", task, "--algo", algorithm, "--units", 4, "--steps", 4000, "--batch-steps", 2000]
    run(*train, "--z", "augment", "--embedding", embedding, "--seeds", 2, "--out", policy)
    assert json.loads((policy / "config.json").read_text())["algorithm"]["units"] == [4]
    run(*train, "--z", "augment", "--embedding", embedding, "--seeds", 2, "--out", policy)  # it is finished
    run("play", policy, "--task", task, "--episodes", 2)
    assert main(["play", str(policy)]) == 2  # the files name no code
