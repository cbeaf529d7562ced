"""Make the golden artefacts of the present schemas: python -m tests.golden.make FOLDER

They are made once for each schema version, committed, and read forever after by `test_golden`. An old folder
is never made again.
"""

import json
import shutil
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from planspace.demos.load import load_demos
from planspace.embed.config import PRESETS
from planspace.embed.saved_embedding import load_embedding
from planspace.rl.algorithms.sac import SAC
from planspace.rl.config import TrainConfig
from planspace.rl.history import load_history
from planspace.rl.saved_policy import load_policy
from planspace.storage.files import TEMPORARY_PREFIX
from planspace.study.design import Arm, Study
from planspace.study.execute import WHOLE, folder_of, read_result_file
from planspace.study.results import UnitResult
from planspace.study.run import run_study
from planspace.study.unit import FitUnit, PlansUnit, PolicyUnit

PLANS = PlansUnit("cartpole-swingup", 3, (("polish_max_iterations", 10), ("restarts", 1)))
FIT = FitUnit(PLANS, replace(PRESETS["modern"], steps=60, batch=32, hidden=(16, 16)), num_seeds=1)
SMALL_SAC = SAC(hidden=(16, 16), critic_hidden=(16, 16), updates_per_step=0.1, normalise_obs=True)
POLICY = PolicyUnit("cartpole", TrainConfig(SMALL_SAC, steps=2000, num_seeds=2, z="augment"), (FIT,))
"""SAC, because its policies need the newest schema; the policies of 2026-11 are TRPO's."""
GOLDEN = Study("golden", "smoke", "Can it be read?", (Arm("balance", "raw + z", (POLICY,)),))
STATES = np.linspace(-1.0, 1.0, 12).reshape(3, 4)
OBS = np.linspace(-1.0, 1.0, 21).reshape(3, 7)


def make(out: Path) -> None:
    """Run a study of three small units, and keep their folders, results and the values in them."""
    assert run_study(GOLDEN, out) == {}
    for unit, name in ((PLANS, "demos"), (FIT, "embedding"), (POLICY, "run")):
        folder_of(unit, out).rename(out / name)
    shutil.rmtree(out / "work")
    for name in ("run", "embedding"):
        shutil.rmtree(out / name / "checkpoint")
    for mark in (*out.rglob(WHOLE), *out.rglob(f"{TEMPORARY_PREFIX}*")):
        mark.unlink()
    (out / "expected.json").write_text(json.dumps(read(out), indent=1) + "\n")


def unit_of(kind: str, out: Path) -> UnitResult:
    """The result of the only unit of a kind; its file name does not matter."""
    (file,) = (out / "units").glob(f"{kind}-*.json")
    return read_result_file(file, kind)


def read(out: Path) -> dict[str, object]:
    """The values that are read from the artefacts."""
    demos, embedding = load_demos(out / "demos"), load_embedding(out / "embedding")
    policy, history = load_policy(out / "run", 1), load_history(out / "run")
    return {
        "demos": {"hash": demos.hash, "last": demos.states[-1].tolist(), "count": len(demos)},
        "embedding": {
            "hash": embedding.hash,
            "z": embedding.encode(STATES).tolist(),
            "decoded": embedding.decode(embedding.encode(STATES)).tolist(),
            "outside": embedding.outside_support(STATES).tolist(),
        },
        "policy": {"actions": policy(OBS).tolist(), "seeds": policy.about["seeds"]},
        "history": {"return": history["return"].tolist(), "steps": history["steps"].tolist()},
        "units": {
            file.stem: sorted(json.loads(file.read_text())["found"])
            for file in sorted((out / "units").glob("*.json"))
        },
        "found": {kind: asdict(unit_of(kind, out).found) for kind in ("plans", "policies")},
    }


if __name__ == "__main__":
    make(Path(sys.argv[1]))
