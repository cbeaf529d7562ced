from dataclasses import replace

import pytest

from planspace.embed.config import PRESETS
from planspace.errors import UsageError
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.study.grid import BUDGETS, STUDIES, make_study
from planspace.study.unit import FitUnit, PlansUnit, PolicyUnit
from planspace.tasks.problem_file import load_problem

PLANS = PlansUnit("cartpole-swingup", 20)
FIT = FitUnit(PLANS, PRESETS["modern"])
POLICY = PolicyUnit("cartpole-swingup", TrainConfig(z="augment"), (FIT,))


def test_a_unit_name_depends_on_everything_the_unit_depends_on() -> None:
    assert replace(POLICY).name == POLICY.name
    others = [
        replace(POLICY, config=replace(POLICY.config, seed=5)),
        replace(POLICY, config=POLICY.config.with_hyperparameters(discount=0.9)),
        replace(POLICY, fits=(replace(FIT, seed=1),)),
        replace(POLICY, fits=(replace(FIT, plans=replace(PLANS, num=21)),)),
        replace(POLICY, fits=(replace(FIT, plans=replace(PLANS, settings=(("restarts", 1),))),)),
    ]
    assert len({unit.name for unit in (POLICY, *others)}) == 1 + len(others)


def test_unit_names_hash_the_content_of_presets_and_problems() -> None:
    unit = PolicyUnit("cartpole", TrainConfig(find_algorithm("ppo", "modern")))
    assert unit.spec["config"]["algorithm"]["name"] == "ppo"
    assert unit.spec["config"]["algorithm"]["on_policy"]["critic"] == "mlp"
    assert FIT.spec["config"]["objective"]["linearity"] == PRESETS["modern"].objective.linearity
    assert FIT.spec["plans"]["problem_hash"] == load_problem("cartpole-swingup").hash


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("budget", BUDGETS)
def test_studies_are_consistent(name: str, budget: str) -> None:
    study = make_study(name, budget)
    names = [arm.name for arm in study.arms]
    assert len(set(names)) == len(names)
    for claim in study.claims:
        assert claim.arm in names and (claim.other in names or not claim.other), claim
        assert claim.expects != "same" or claim.margin > 0
    texts = [claim.text for claim in study.claims]
    assert len(set(texts)) == len(texts)
    seen: set[str] = set()
    for unit in study.units:
        assert all(need.name in seen for need in unit.needs)
        seen.add(unit.name)
    for arm in study.arms:
        seeds = [seed for unit in arm.units for seed in unit.config.seeds]
        assert seeds == list(range(seeds[0], seeds[0] + len(seeds)))
        assert len({unit.config.steps for unit in arm.units}) == 1


def test_the_paper_study_has_two_systems_two_sizes_and_fifteen_seeds() -> None:
    study = make_study("paper", "paper")
    assert len(study.arms) == 2 * 4 * 5
    fits = [unit for unit in study.units if isinstance(unit, FitUnit)]
    assert {(fit.plans.problem, fit.config.z_dim) for fit in fits} == {
        (problem, z) for problem in ("cartpole-swingup", "reacher") for z in (3, 10)
    }
    assert all(fit.num_seeds == 5 and fit.config.preset == "paper" for fit in fits)
    assert all(sum(unit.config.num_seeds for unit in arm.units) == 15 for arm in study.arms)
    assert {unit.config.steps for arm in study.arms for unit in arm.units} == {8_000_000}


def test_the_reachers_that_observe_only_z_are_run_once() -> None:
    study = make_study("paper", "half")
    arms = {arm.name: arm for arm in study.arms}
    for size in ("low-Z only", "high-Z only"):
        trig, raw = (arms[f"reacher-{form}, TRPO/{size}"] for form in ("trig", "raw"))
        assert trig.units == raw.units
    policies = [unit for unit in study.units if isinstance(unit, PolicyUnit)]
    assert len(policies) == 3 * (40 - 4)


def test_studies_share_equal_units() -> None:
    paper, controls = make_study("paper", "half"), make_study("controls", "half")
    shared = {unit.name for unit in paper.units} & {unit.name for unit in controls.units}
    assert len(shared) == 2 + 3 * 4  # two sets of demonstrations; raw on two tasks with two algorithms


def test_more_seeds_add_units_to_the_first_ones() -> None:
    few, many = make_study("paper", "half"), make_study("paper", "half", seeds=50)
    assert {unit.name for unit in few.units} < {unit.name for unit in many.units}
    assert all(sum(unit.config.num_seeds for unit in arm.units) == 50 for arm in many.arms)
    with pytest.raises(UsageError, match="must be a positive multiple of 5, got 12"):
        make_study("paper", "half", seeds=12)


def test_the_recipe_has_fifteen_policies_for_each_of_five_embeddings() -> None:
    arm = make_study("recipe", "full").arms[0]
    assert arm.num_embeddings == 5
    seeds = [seed for unit in arm.units for seed in unit.config.seeds]
    assert [sum(seed % 5 == g for seed in seeds) for g in range(5)] == [15] * 5
    used = {seed for name in ("paper", "controls", "demos") for a in make_study(name, "full").arms
            for unit in a.units for seed in unit.config.seeds}  # fmt: skip
    assert not {*used, *range(100, 106)} & set(seeds) and min(fit.seed for fit in arm.units[0].fits) == 10


def test_only_keeps_the_claims_about_the_selected_arms() -> None:
    study = make_study("paper", "half").only(["swingup, TRPO/raw", "swingup, TRPO/low-Z augment"])
    assert len(study.arms) == 2
    assert len(study.claims) == 4  # mean, speed, best case, spread
    with pytest.raises(
        UsageError,
        match=r"no arm of study paper has 'nothing' in its name\. Its arms: cartpole, TRPO/raw;",
    ):
        make_study("paper", "half").only(["nothing"])


def test_unknown_names_are_rejected_with_a_suggestion() -> None:
    with pytest.raises(UsageError, match="unknown study 'controle'. Did you mean 'controls'?"):
        make_study("controle", "half")
    with pytest.raises(UsageError, match="unknown budget 'ful'. Did you mean 'full'?"):
        make_study("paper", "ful")
