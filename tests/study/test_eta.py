from pathlib import Path

import pytest

from planspace.study.eta import Timings, time_left
from planspace.study.grid import make_study
from planspace.study.results import PlansResult, UnitResult
from planspace.study.summary import read_findings
from planspace.study.unit import PlansUnit

from ..tiny_study import FIT, PLANS, policy

RESULTS = Path(__file__).parents[2] / "results" / "study"


def timings(**seconds: float) -> Timings:
    """Timings with these seconds per unit of each kind."""
    found = Timings()
    for unit in (PLANS, FIT, policy(0)):
        found.add(unit, seconds[unit.kind])
    return found


def test_the_time_left_includes_waiting_for_other_units() -> None:
    each = timings(plans=10.0, fit=20.0, policies=40.0)
    # raw 0: 0 to 40; plans: 0 to 10; fit: 10 to 30; raw 1: 30 to 70; z 0: 40 to 80; z 1: 70 to 110
    units = [policy(0), PLANS, FIT, policy(1), policy(0, z=True), policy(1, z=True)]
    assert time_left(units, {}, each, size=2) == pytest.approx(110)
    assert time_left(units, {}, each, size=1, cores=2.0) == pytest.approx((10 + 20 + 4 * 40) / 2)
    # the last two units run: the pool is not divided among fewer units than it has places
    assert time_left([], {"a": 25.0, "b": 3.0}, each, size=4) == 25.0
    assert time_left([FIT], {PLANS.name: 5.0}, each, size=4) == pytest.approx(5 + 20)
    assert time_left([], {}, each, size=4) == 0.0


def test_interrupted_units_are_not_timed() -> None:
    seconds = UnitResult(PlansResult(1, 1.0, 1.0), 3.0, 1)
    resumed = UnitResult(seconds.found, 0.1, 1, resumed=True)
    other = PlansUnit("reacher", 12)
    assert Timings.of([PLANS, other], {PLANS.name: seconds, other.name: resumed}).num_timed == 1


def test_the_guess_before_a_study_agrees_with_its_measured_time() -> None:
    study = make_study("paper", "half")
    results = read_findings(study, RESULTS).results
    measured = Timings.of(study.units, results)
    assert measured.num_timed == len(study.units)
    guessed = sum(unit.cost for unit in study.units)
    assert guessed == pytest.approx(measured.core_seconds, rel=0.25)
    # on two cores, at the start: the time of the whole study, as its report says
    assert time_left(study.units, {}, measured, size=2) == pytest.approx(measured.core_seconds / 2, rel=0.02)
