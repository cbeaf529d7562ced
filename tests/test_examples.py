"""Every example runs on a tiny budget."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from planspace import plan_demos
from planspace.demos.describe import replay_errors

EXAMPLES = Path(__file__).parents[1] / "examples"
EMBEDDING, OUT = "EMBEDDING", "OUT"

CASES = [
    ("agents_sb3.py", (EMBEDDING, "--agent", agent, "--workers", workers, *tiny), r"return -\d+\.\d")
    for agent in ("ppo", "trpo")
    for workers in (("ours", "subproc") if agent == "ppo" else ("ours",))
    for tiny in [("--num-envs", "2", "--steps", "4000")]
]
CASES += [
    ("gymnasium_mujoco.py", ("Reacher-v5", "--out", OUT), "has 10 numbers, and 13 with z"),
    ("gymnasium_mujoco.py", ("InvertedPendulum-v5", "--out", OUT), "has 4 numbers, and 7 with z"),
    ("numpy_search.py", (EMBEDDING, "--num-envs", "20", "--iterations", "2"), r"iteration 1: mean +-\d"),
    ("sb3_features.py", (EMBEDDING, "--num-envs", "2", "--steps", "4000"), r"features 7, return -\d+\.\d"),
    (
        "jax_env.py",
        (EMBEDDING, "--num-envs", "8", "--iterations", "2"),
        r"iteration 1: mean distance in z \d",
    ),
    (
        "her_goals.py",
        (EMBEDDING, "--steps", "220", "--episodes", "1"),
        r"z_desired_goal, z_difference; reached \d of 1 goals",
    ),
    ("jax_loop.py", (EMBEDDING, "--num-envs", "5", "--iterations", "2"), r"iteration 1: return -\d"),
    (
        "minari_demos.py",
        ("swingup/expert-v0", "--episodes", "12", "--out", OUT),
        r"(?s)episode 11 ends 0\.[01]\d from.*planspace embed minari:",
    ),
]
NEEDS = {
    "agents_sb3.py": "sb3_contrib",
    "sb3_features.py": "stable_baselines3",
    "her_goals.py": "stable_baselines3",
    "minari_demos.py": "minari",
}
FEW = {"gymnasium_mujoco.py": ("--num", "12", "--steps", "20"), "minari_demos.py": ("--steps", "20")}


LONG = (
    "Reacher-v5", "InvertedPendulum-v5", "swingup/expert-v0", "trpo", "subproc", "sb3_features.py",
    "her_goals.py",
)  # fmt: skip
"""Scripts and arguments of the longest runs."""
RUNS = [
    pytest.param(
        *case,
        id=f"{case[0]}-{case[1][0]}-{case[1][2]}",
        marks=pytest.mark.nightly if {case[0], *case[1]} & set(LONG) else pytest.mark.slow,
    )
    for case in CASES
]


@pytest.mark.parametrize(("script", "arguments", "says"), RUNS)
def test_example_runs(
    script: str, arguments: tuple[str, ...], says: str, embedding_folder: Path, tmp_path: Path
) -> None:
    if script in NEEDS:
        pytest.importorskip(NEEDS[script], reason="needs an extra")
    paths = {EMBEDDING: str(embedding_folder), OUT: str(tmp_path / "out")}
    command = [sys.executable, str(EXAMPLES / script), *(paths.get(a, a) for a in arguments)]
    done = subprocess.run(
        [*command, *FEW.get(script, ())],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "MINARI_DATASETS_PATH": str(tmp_path / "minari")},
    )
    assert done.returncode == 0, done.stderr
    assert re.search(says, done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("robot", sorted(path.stem for path in (EXAMPLES / "robots").glob("*.yaml")))
def test_plans_for_every_robot(robot: str, tmp_path: Path) -> None:
    demos = plan_demos(str(EXAMPLES / "robots" / f"{robot}.yaml"), 1, out=tmp_path / "demos")
    assert demos.success.all()
    assert replay_errors(demos).max() < 1e-9


def test_every_example_is_tested() -> None:
    assert {case[0] for case in CASES} == {file.name for file in EXAMPLES.glob("*.py")}
