from dataclasses import replace

import numpy as np
import pytest

from planspace.study.design import Arm, Claim
from planspace.study.execute import _round_all
from planspace.study.findings import Findings
from planspace.study.stats import Scores
from planspace.study.summary import summarise
from planspace.study.unit import PolicyUnit

from ..tiny_study import BASE, RAW, TINY, WITH_Z, policy


def test_a_claim_is_not_finished_until_all_seeds_are_run() -> None:
    seeds = tuple(policy(seed) for seed in range(6))
    study = replace(TINY, arms=(replace(RAW, units=seeds), WITH_Z), claims=())
    claim = Claim("near 100", "ours", "final", RAW.name, "", margin=1.0)
    scores = Scores(tuple(range(5)), np.array([8000]), np.full((1, 5), 99.0), 0)
    found = summarise(Findings(replace(study, claims=(claim,)), {}, {RAW.name: scores}, {})).claims[0]
    assert found.verdict == "not finished" and found.number == 99.0


def test_a_missing_measure_of_an_embedding_is_stored_as_none() -> None:
    """The training log has None for a validation split that is too small to measure."""
    assert _round_all([1.2345, None, float("nan")], 2) == [1.23, None, None]


def test_returns_over_tasks_are_normalised_by_levels() -> None:
    arms = [
        Arm(f"{task}, TRPO", label, (PolicyUnit(unit_task, BASE),))
        for task, unit_task in (("cartpole", "cartpole"), ("reacher-trig", "reacher-raw"))  # a shared unit
        for label in ("raw", "z only")
    ]
    study = replace(TINY, arms=tuple(arms), claims=())
    # halfway between idle and solved on both tasks
    reached = {arm.name: [50.0 if arm.task == "cartpole" else -10.0] * 5 for arm in arms}
    steps = np.array([400_000])
    scores = {name: Scores((0, 1, 2, 3, 4), steps, np.array([values]), 0) for name, values in reached.items()}
    rows = summarise(Findings(study, {}, scores, {})).over_tasks
    assert [(row.algo, row.arm, row.tasks) for row in rows] == [
        ("TRPO", "raw", 2),
        ("TRPO", "z only", 2),
    ]
    assert all(row.iqm == 0.5 and row.iqm_interval == (0.5, 0.5) for row in rows)
    single = replace(study, arms=(arms[0], arms[2]))
    assert summarise(Findings(single, {}, scores, {})).over_tasks == []  # a single arm cannot be compared


@pytest.mark.parametrize(
    ("claim", "rule"),
    [
        (Claim("", "", "final", "a/x", "a/y"), "final: x − y > 0"),
        (Claim("", "", "final", "a/x", "a/y", "less", 5.0), "final: x − y < -5"),
        (Claim("", "", "early", "a/x", "a/y", "less"), "early: x − y < 0"),
        (Claim("", "", "best", "a/x", "a/y", "same", 5.0), "best: x − y within ±5"),
        (Claim("", "", "final", "a/x", "", margin=80.0), "final: x > 80"),
        (Claim("", "", "spread", "a/x", "a/y"), "standard deviation: y / x > 1"),
        (Claim("", "", "final", "a/x", "b/x"), "final: x (a) − x (b) > 0"),
    ],
)
def test_the_rule_of_a_claim_is_written_out(claim: Claim, rule: str) -> None:
    arms = tuple(Arm(panel, label, (policy(0),)) for panel in "ab" for label in "xy")
    found = summarise(Findings(replace(TINY, arms=arms, claims=(claim,)), {}, {}, {})).claims[0]
    assert found.rule == rule


def test_a_spread_is_judged_by_its_logarithm_and_shown_as_a_ratio() -> None:
    arms, steps = tuple(Arm("a", label, (policy(0),)) for label in "xy"), np.array([8000])
    study = replace(TINY, arms=arms, claims=(Claim("", "", "spread", "a/x", "a/y"),))
    x, seeds = np.arange(20.0)[None], tuple(range(20))
    scores = {"a/x": Scores(seeds, steps, x, 0), "a/y": Scores(seeds, steps, 3 * x, 0)}
    found = summarise(Findings(study, {}, scores, {})).claims[0]
    assert found.number == pytest.approx(3.0) and found.interval == pytest.approx((3.0, 3.0))
