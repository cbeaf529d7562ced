"""Plans are followed where that leads to the goal, and nowhere else."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace import Controller, Embedding, UsageError, load_demos, load_embedding
from planspace.control import follow
from planspace.control.config import ControlConfig
from planspace.control.episodes import run_episode
from planspace.demos.dataset import Demos

from ..cli.calls import call

CONFIG = ControlConfig(samples=16, follow_s=3.0)
OUTSIDE = np.array([50.0, np.pi, 0.0, 0.0])
"""A state off the rail, from which no plan leads to the goal."""


def controller_of(embedding: Embedding, demos: Demos, config: ControlConfig = CONFIG) -> Controller:
    return Controller("cartpole-swingup", embedding, config, plans=demos)


def test_a_plan_is_followed_from_beside_it_and_not_from_far_away(
    embedding: Embedding, demos: Demos, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(follow, "NEAREST", 1)  # the best state of a plan is enough
    controller = controller_of(embedding, demos)
    start = demos.episode(0).states[0] + np.array([0.01, 0.02, 0.0, 0.0])
    simulator = controller.plant.simulator(1)
    simulator.reset(start[None])
    kinds = []
    for _ in range(100):
        control = controller(simulator.states()[0])
        kinds.append(
            "followed" if controller.followed else "regulated" if controller.regulated else "searched"
        )
        simulator.step(control[None], controller.plant.physics_steps)
    assert kinds[0] == "followed" and "searched" not in kinds and kinds[-1] == "regulated"
    assert controller.plant.at_goal(simulator.states(), np.empty(0)).all()
    controller.reset(0)
    controller(OUTSIDE)
    assert not controller.followed and not controller.regulated


def test_following_needs_no_embedding(demos: Demos) -> None:
    controller = Controller("cartpole-swingup", None, replace(CONFIG, cost="reward"), plans=demos)
    controller(demos.episode(0).states[0])
    assert controller.followed


def test_a_plan_is_left_when_the_robot_is_pushed_away(embedding: Embedding, demos: Demos) -> None:
    controller = controller_of(embedding, demos)
    controller(demos.episode(0).states[0])
    assert controller.followed
    found = []
    for _ in range(5):  # the next trial comes within a tenth of a second
        controller(OUTSIDE)
        found.append(controller.followed)
    assert not found[-1]


def test_a_plan_is_not_gone_on_with_after_the_regulator(embedding: Embedding, demos: Demos) -> None:
    controller = controller_of(embedding, demos)
    controller(demos.episode(0).states[0])
    assert controller.followed
    controller(np.zeros(4))
    assert controller.regulated
    controller(OUTSIDE)
    assert not controller.followed and not controller.regulated


def test_a_plan_that_is_too_long_is_followed_from_its_last_part_only(
    embedding: Embedding, demos: Demos
) -> None:
    plan = demos.episode(0)
    controller = controller_of(embedding, demos, replace(CONFIG, follow_s=0.5))
    controller(plan.states[0])
    assert not controller.followed
    controller.reset(0)
    controller(plan.states[np.searchsorted(plan.times, plan.times[-1] - 0.4)])
    assert controller.followed or controller.regulated


@pytest.mark.slow
def test_ten_plans_swing_the_acrobot_up_from_starts_where_the_look_ahead_alone_fails() -> None:
    embedding, plans = load_embedding("acrobot-swingup"), load_demos("acrobot-swingup")
    alone = ControlConfig(cost="time", samples=64)
    episodes = {
        name: run_episode(Controller("acrobot-swingup", embedding, config, plans=plans), 0, 0)
        for name, config in {"alone": alone, "following": replace(alone, follow_s=3.0)}.items()
    }
    assert episodes["following"].success and not episodes["alone"].success
    assert episodes["following"].followed.mean() > 0.1 and not episodes["alone"].followed.any()


def test_what_does_not_fit_is_refused(
    embedding: Embedding, demos: Demos, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UsageError, match="follow_s needs plans to follow: give `plans`"):
        Controller("cartpole-swingup", embedding, CONFIG)
    with pytest.raises(UsageError, match="have no shoulder"):
        Controller("acrobot-swingup", load_embedding("acrobot-swingup"), CONFIG, plans=demos)
    with pytest.raises(UsageError, match="at least one control step of 0.04 s, got 0.01"):
        controller_of(embedding, demos, replace(CONFIG, follow_s=0.01))
    bare = replace(demos, controls=0 * demos.controls)
    with pytest.raises(UsageError, match="need 1 controls a step that are not all 0, and these have 1"):
        controller_of(embedding, bare)
    with pytest.raises(UsageError, match="follow_s needs the regulator"):
        replace(CONFIG, regulator=False)
    for value in (-1.0, np.inf):
        with pytest.raises(UsageError, match="`follow_s` must be at least 0 and finite"):
            replace(CONFIG, follow_s=value)
    out = tmp_path / "run"
    options = ("--embedding", "cartpole-swingup", "--follow-s", 3, "--out", out)
    code, _, err = call(capsys, "control", "cartpole-swingup", *options)
    assert code == 2 and "give --plans DIR" in err and not out.exists()
    code, _, err = call(capsys, "control", "cartpole-swingup", *options, "--plans", "acrobot-swingup")
    assert code == 2 and "acrobot-swingup has the states (shoulder," in err and not out.exists()


@pytest.mark.slow
def test_the_settings_of_a_run_that_followed_plans_can_be_used_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "cartpole-swingup"
    arguments = ("control", name, "--embedding", name, "--plans", name)
    short = ("--episodes", 1, "--episode-s", 0.2, "--samples", 8, "--no-film", "--json")
    code, first, _ = call(capsys, *arguments, *short, "--follow-s", 3, "--out", tmp_path / "one")
    assert code == 0 and json.loads(first)["followed"] > 0
    config = tmp_path / "one" / "config.json"
    code, second, _ = call(capsys, *arguments, *short, "--config", config, "--out", tmp_path / "two")
    assert code == 0 and json.loads(second)["followed"] == json.loads(first)["followed"]
