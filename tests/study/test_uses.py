"""The study `uses`: valid arms, units that hand demonstrations to policies, and returns of evaluations."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from planspace.control.config import ControlConfig
from planspace.demos.folder import LOG
from planspace.demos.load import load_demos
from planspace.errors import PlanspaceError
from planspace.plan.demonstrations import simulated_steps
from planspace.rl.algorithms import find_algorithm
from planspace.rl.checks import check_uses_of_plans
from planspace.study import execute as module
from planspace.study.design import Arm, Study
from planspace.study.execute import execute, folder_of, read_result
from planspace.study.findings import Findings
from planspace.study.grid import make_study
from planspace.study.results import PoliciesResult
from planspace.study.run import run_study
from planspace.study.stats import Scores, final
from planspace.study.summary import read_findings, summarise
from planspace.study.tidy import read_tidy, write_tidy
from planspace.study.unit import GuideUnit, PolicyUnit
from planspace.study.uses import GUIDE, NO_PLANS, Use, comparisons, ways

from ..tiny_study import FIT, PLANS, RAW, policy

TASK = "cartpole-swingup"
GUIDE_UNIT = GuideUnit(TASK, PLANS, FIT, 2, ControlConfig(horizon_s=0.16, samples=16, follow_s=3.0))


def test_every_arm_is_a_valid_setting_with_the_units_that_it_needs() -> None:
    for arm in make_study("uses", "half").arms:
        (unit, *_), replays = arm.units, arm.panel.endswith("SAC")
        check_uses_of_plans(unit.config)
        assert (unit.demos is None) == (not unit.config.uses_of_plans) == (arm.label == NO_PLANS)
        assert isinstance(unit.demos, GuideUnit) == (arm.label == GUIDE)
        assert unit.config.needs_embedding == bool(unit.fits)
        assert len(unit.fits) < 2  # replay needs one embedding for all seeds
        assert unit.config.seeds[0] == 500 and unit.config.reward == "sparse"
        assert unit.config.steps == (100_000 if replays else 1_000_000)
        assert len(unit.config.evaluations) >= 20


def test_an_algorithm_without_a_replay_buffer_has_no_arms_that_replay() -> None:
    for replays in (True, False):
        arms = ways(replays)
        assert any("replay" in use.settings for use in arms.values()) == replays
        assert {name for _, *pair in comparisons(replays) for name in pair} <= arms.keys()
    assert ways(False)["resets + z"] == Use({"resets": 0.5, "z": "augment"}, "variational")


def test_a_task_whose_target_is_not_a_state_has_no_guide() -> None:
    study = make_study("uses", "smoke", task="reacher-trig")
    labels = [arm.label for arm in study.arms]
    assert GUIDE not in labels and len(labels) == len(ways(True)) - 1
    assert all(GUIDE not in claim.text for claim in study.claims)
    assert "reacher-trig has no guide: its goal is not a state." in study.notes


def test_policies_use_plans_of_their_own_task() -> None:
    """The embeddings of `cartpole` learn from swing-ups, in which its episodes would end at once."""
    study = make_study("uses", "smoke", task="cartpole")
    for arm in study.arms:
        (unit,) = arm.units
        assert {fit.plans.problem for fit in unit.fits} <= {"cartpole-swingup"}
        demos = unit.demos.plans if isinstance(unit.demos, GuideUnit) else unit.demos
        assert demos is None or demos.problem == "cartpole"


def test_a_cloned_policy_of_trpo_begins_with_little_noise_in_units_of_its_control() -> None:
    arms = {arm.name: arm.units[0].config for arm in make_study("uses", "half").arms}
    std = {name: getattr(config.algorithm, "on_policy", None) for name, config in arms.items()}
    assert std["cartpole-swingup, TRPO/cloning"].initial_std == pytest.approx(0.3)  # of -3 to 3 N
    assert std["acrobot-swingup, TRPO/guide"].initial_std == pytest.approx(1.0)  # of -10 to 10 N m
    assert std["cartpole-swingup, TRPO/resets"].initial_std == 1.0


def test_a_unit_is_named_after_its_demonstrations_only_if_it_uses_some() -> None:
    plain = policy(0)
    assert "demos" not in plain.spec
    with_plans, guided = (replace(plain, demos=demos) for demos in (PLANS, GUIDE_UNIT))
    assert len({plain.name, with_plans.name, guided.name}) == 3
    assert with_plans.needs == (PLANS,) and guided.needs == (GUIDE_UNIT,)
    other = replace(GUIDE_UNIT, config=replace(GUIDE_UNIT.config, samples=32))
    assert other.name != GUIDE_UNIT.name


def test_an_evaluated_study_judges_evaluations() -> None:
    found = PoliciesResult((0,), (100, 200), ([5.0], [9.0]), (False,), (100, 200), ([1.0], [2.0]))
    assert final(Scores.of(RAW, [found])) == [9.0]
    evaluated = Scores.of(RAW, [found], evaluated=True)
    assert final(evaluated) == [2.0] and evaluated.returns.tolist() == [[1.0], [2.0]]


def test_a_sparse_return_counts_by_the_steps_at_the_goal() -> None:
    config = replace(policy(0).config, reward="sparse")
    arms = tuple(
        Arm(f"{task}, TRPO", label, (PolicyUnit(task, config),))
        for task in (TASK, "pendulum-swingup")
        for label in ("a", "b")
    )
    study = Study("tiny", "smoke", "?", arms, evaluated=True)
    scores = {arm.name: Scores((0, 1), np.array([400]), np.full((1, 2), 50.0), 0) for arm in arms}
    rows = summarise(Findings(study, {}, scores, {})).over_tasks
    assert [row.iqm for row in rows] == [0.25, 0.25]  # 50 of 200 steps


@pytest.fixture(scope="module")
def guided(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Path]:
    """A finished study of policies without plans, with plans, and with a guide."""
    use = ways(False)[GUIDE].settings
    config = replace(policy(0).config, steps=4000, eval_every=1, **use)
    plain = replace(policy(0), task=TASK)
    units = (plain, PolicyUnit(TASK, config, (), PLANS), PolicyUnit(TASK, config, (), GUIDE_UNIT))
    arms = tuple(
        Arm(f"{TASK}, TRPO", x, (u,)) for x, u in zip((NO_PLANS, "plans", GUIDE), units, strict=True)
    )
    study, out = Study("tiny", "smoke", "?", arms, evaluated=True), tmp_path_factory.mktemp("guided")
    assert run_study(study, out, workers=1) == {}
    return study, out


@pytest.mark.slow
def test_policies_use_the_plans_or_the_episodes_of_a_guide(guided: tuple[Study, Path]) -> None:
    study, out = guided
    found = read_result(GUIDE_UNIT, out).found
    episodes = load_demos(folder_of(GUIDE_UNIT, out) / "demos")
    assert found.hash == episodes.hash and found.count == len(episodes) > 0
    assert found.reached == found.count / 2
    settings = [json.loads((folder_of(a.units[0], out) / "config.json").read_text()) for a in study.arms]
    hashes = [load_demos(folder_of(PLANS, out)).hash, episodes.hash]
    assert [config["plans"] for config in settings[1:]] == hashes and "plans" not in settings[0]


@pytest.mark.slow
def test_the_costs_of_arms_count_what_they_need(guided: tuple[Study, Path], tmp_path: Path) -> None:
    study, out = guided
    findings = read_findings(study, out)
    none, plans, guide = summarise(findings).costs
    counted = simulated_steps(folder_of(PLANS, out))
    assert (none.needs_core_seconds, none.simulated_steps) == (0, 0)
    controlled = read_result(GUIDE_UNIT, out).found.simulated_steps
    assert plans.simulated_steps == counted > 10_000
    assert guide.simulated_steps == counted + controlled and controlled > 10_000
    assert guide.needs_core_seconds > plans.needs_core_seconds > 0
    write_tidy(findings, tmp_path / "results.csv")
    read = summarise(read_tidy(study, tmp_path / "results.csv", {}))
    assert read.plans == summarise(findings).plans and read.claims == summarise(findings).claims
    assert [row.simulated_steps for row in read.costs] == [0, counted, counted + controlled]
    assert [row.mean for row in read.panels[study.arms[0].panel]] == pytest.approx(
        [row.mean for row in summarise(findings).panels[study.arms[0].panel]], abs=1e-5
    )


@pytest.mark.slow
def test_a_folder_of_a_version_that_did_not_count_has_no_simulated_steps(
    guided: tuple[Study, Path], tmp_path: Path
) -> None:
    log = (folder_of(PLANS, guided[1]) / LOG).read_text().splitlines()
    rows = [{k: v for k, v in json.loads(line).items() if k != "simulated_steps"} for line in log]
    (tmp_path / LOG).write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert simulated_steps(tmp_path) is None


@pytest.mark.slow
def test_a_guide_that_misses_the_goal_is_an_error(
    guided: tuple[Study, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "control_into", lambda *_, **__: SimpleNamespace(success=0.0))
    with pytest.raises(PlanspaceError, match="control of cartpole-swingup held the goal in none of 3 ep"):
        execute(replace(GUIDE_UNIT, num=3), guided[1])


def test_the_first_guess_of_the_time_of_sac_depends_on_its_networks() -> None:
    wide = find_algorithm("sac", "modern")
    narrow = replace(wide, hidden=(64, 64), critic_hidden=(64, 64))
    assert wide.steps_a_second == 100 and 600 < narrow.steps_a_second < 800
