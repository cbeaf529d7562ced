"""Agents of Stable-Baselines3 and sb3-contrib learn with z, and act the same in a new process."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sb3_contrib", reason="needs the extra sb3")

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "agent_matrix.py"
SWING_UP, GOALS = "planspace/CartPoleSwingUp-v0", "CartGoals (examples/her_goals.py)"
CASES = [
    *(f"stable-baselines3:{name}:{SWING_UP}" for name in ("PPO", "SAC", "TD3")),
    "stable-baselines3:DQN:CartPole-v1",
    f"stable-baselines3:HER+SAC:{GOALS}",
    *(f"sb3-contrib:{name}:{SWING_UP}" for name in ("RecurrentPPO", "TQC", "CrossQ")),
]


@pytest.mark.nightly
def test_same_actions_after_loading_in_a_new_process(embedding_folder: Path, tmp_path: Path) -> None:
    for part in ("train", "load"):
        command = [sys.executable, SCRIPT, "--part", part, embedding_folder, tmp_path, *CASES]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    for i, case in enumerate(CASES):
        trained, loaded = (np.load(tmp_path / str(i) / f"{part}.npy") for part in ("train", "load"))
        np.testing.assert_array_equal(trained, loaded, err_msg=case)
        assert len(np.unique(trained, axis=0)) > 1 or case.endswith("CartPole-v1")
