"""A study of six small units, for tests."""

from dataclasses import replace
from pathlib import Path

from planspace.embed.config import PRESETS
from planspace.rl.config import TrainConfig
from planspace.study.design import Arm, Claim, Study
from planspace.study.execute import read_result
from planspace.study.pool import LocalPool
from planspace.study.results import Found
from planspace.study.unit import FitUnit, PlansUnit, PolicyUnit, Unit

PLANS = PlansUnit("cartpole-swingup", 12, (("polish_max_iterations", 10), ("restarts", 1)))
FIT = FitUnit(PLANS, replace(PRESETS["modern"], steps=60, batch=32), num_seeds=2)
BASE = TrainConfig(steps=8000, num_seeds=1)


def policy(seed: int, z: bool = False) -> PolicyUnit:
    config = replace(BASE, seed=seed, z="augment" if z else "none")
    return PolicyUnit("cartpole", config, (FIT,) if z else ())


RAW = Arm("balance", "raw", (policy(0), policy(1)))
WITH_Z = Arm("balance", "raw + z", (policy(0, z=True), policy(1, z=True)))
TINY = Study(
    "tiny",
    "smoke",
    "Does it run?",
    (RAW, WITH_Z),
    (Claim("z helps", "ours", "final", WITH_Z.name, RAW.name),),
)


def run_alone(unit: Unit, out: Path) -> None:
    """Run one unit in a worker process, even if it has a result."""
    pool = LocalPool(out, 1)
    pool.start(unit)
    while not (ended := pool.wait()):
        pass
    assert list(ended) == [(unit, None)]


def what_was_found(study: Study, out: Path) -> dict[str, Found]:
    return {unit.name: read_result(unit, out).found for unit in study.units}
