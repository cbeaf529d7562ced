"""Agents of other libraries on environments with z: trained, saved, and loaded in a new process.

    python benchmarks/agent_matrix.py
    python benchmarks/agent_matrix.py --only tianshou

Each row trains an agent for a few hundred steps, saves it, loads it in a new process, and compares the
actions for the same observations, bit for bit. It shows that the libraries and the wrappers work together; a
few hundred steps solve no task. A library that is not installed keeps its row of an earlier run. Writes
results/agents/matrix.csv and prints the table of docs/howto/agents.md.

d3rlpy 2.8.1 asks for Gymnasium 1.0.0, and planspace needs 1.1: install it with `pip install --no-deps`.
FetchReach of gymnasium-robotics 1.4.2 compares types of joints in an `assert` that fails with MuJoCo 3.17, so
its row runs with `python -O`, which leaves out assertions.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from agent_libraries import LIBRARIES
from csv_rows import read_rows, write_rows

import planspace as ps
from planspace.envs.wrappers import PlanSpaceShaping

FILE = Path(__file__).parent.parent / "results" / "agents" / "matrix.csv"
COLUMNS = ("library", "version", "algorithm", "environment", "wrapper", "trained", "saved-and-loaded equal")
STEPS, NUM_OBS = 400, 20
SWING_UP, CART_POLE = "planspace/CartPoleSwingUp-v0", "CartPole-v1"
MAZE, FETCH, CART_GOALS = "PointMaze_UMaze-v3", "FetchReach-v4", "CartGoals (examples/her_goals.py)"


class Case(NamedTuple):
    """A row of the matrix."""

    library: str
    algorithm: str
    environment: str
    wrapper: str = "z appended"

    @property
    def key(self) -> str:
        """A short name."""
        return f"{self.library}:{self.algorithm}:{self.environment}"


GOALS = "z, z of goals, shaping"
CASES = (
    *(Case("stable-baselines3", name, SWING_UP) for name in ("PPO", "SAC", "TD3")),
    Case("stable-baselines3", "DQN", CART_POLE),
    *(Case("stable-baselines3", "HER+SAC", env, GOALS) for env in (FETCH, MAZE, CART_GOALS)),
    *(Case("sb3-contrib", name, SWING_UP) for name in ("RecurrentPPO", "TQC", "CrossQ")),
    Case("skrl", "PPO", SWING_UP),
    Case("tianshou", "SAC", SWING_UP),
    Case("tianshou", "DQN", CART_POLE),
    Case("d3rlpy", "SAC", SWING_UP),
    Case("d3rlpy", "DQN", CART_POLE),
    Case("own loop (CleanRL style)", "policy gradient", SWING_UP),
)

CART_STATE = ("slider", "hinge", "slidervel", "hingevel")
MAZE_STATE = ("ball_x", "ball_y", "ball_xvel", "ball_yvel")
STATES = {MAZE: MAZE_STATE, FETCH: ("grip_x", "grip_y", "grip_z")}
"""Names of the states of each embedding; that of the cart-pole for the others."""


def make_env(environment: str, embedding: str) -> gymnasium.Env[Any, Any]:
    """Make an environment of the matrix with z."""
    if environment == SWING_UP:
        return ps.wrap(gymnasium.make(SWING_UP), embedding)
    if environment == CART_POLE:
        return ps.wrap(gymnasium.make(CART_POLE), embedding, columns=[0, 2, 1, 3])
    if environment == CART_GOALS:
        sys.path.append(str(Path(__file__).parent.parent / "examples"))
        from her_goals import make_env as make_cart_goals

        return make_cart_goals(embedding)
    import gymnasium_robotics

    gymnasium.register_envs(gymnasium_robotics)
    env = gymnasium.make(environment, max_episode_steps=50)
    if environment == FETCH:
        columns: Any = [f"observation[{i}]" for i in range(3)]
        goal: Any = [f"desired_goal[{i}]" for i in range(3)]
    else:
        columns = None  # the joints have names
        goal = dict(zip(MAZE_STATE, ("desired_goal[0]", "desired_goal[1]", 0.0, 0.0), strict=True))
    return ps.wrap(
        PlanSpaceShaping(env, embedding, goal, columns=columns), embedding, "augment", columns, goal
    )


def make_embedding(environment: str, folder: Path) -> Path:
    """Fit an embedding briefly, on made-up motions that come to rest, and return its folder."""
    names = STATES.get(environment, CART_STATE)
    out = folder / "-".join(names)
    if out.exists():
        return out
    rng, steps = np.random.default_rng(0), 40
    lines = [",".join(("episode", "time", *names))]
    for episode in range(20):
        start = rng.uniform(-2, 2, len(names))
        for i in range(steps):
            row = start * (1 - i / (steps - 1)) ** 2
            lines.append(",".join(map(str, (episode, round(0.04 * i, 2), *row))))
    table, demos = folder / f"{out.name}.csv", folder / f"{out.name}-demos"
    table.write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "planspace"]
    subprocess.run([*command, "demos", "import", table, "--out", demos], check=True, capture_output=True)
    settings = ["--steps", "300", "--seeds", "1"]
    subprocess.run([*command, "embed", demos, "--out", out, *settings], check=True, capture_output=True)
    return out


def agent_of(case: Case) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the functions that train and load the agent of a case."""
    library, algorithm = LIBRARIES[case.library], case.algorithm.removeprefix("HER+")
    arguments = {}
    if case.algorithm.startswith("HER+"):
        from planspace.envs.her import PlanSpaceHerReplayBuffer

        arguments["replay_buffer_class"] = PlanSpaceHerReplayBuffer
    return partial(library.train, algorithm, **arguments), partial(library.load, algorithm)


def collect(env: gymnasium.Env[Any, Any]) -> list[Any]:
    """Observations of random actions."""
    env.action_space.seed(1)
    observations = [env.reset(seed=1)[0]]
    while len(observations) < NUM_OBS:
        obs, _, terminated, truncated, _ = env.step(env.action_space.sample())
        observations.append(env.reset()[0] if terminated or truncated else obs)
    return observations


def run_part(part: str, case: Case, embedding: str, folder: Path) -> None:
    """Train and save, or load; then write the actions. Each part runs in a process of its own."""
    train, load = agent_of(case)
    env = make_env(case.environment, embedding)
    folder.mkdir(parents=True, exist_ok=True)
    if part == "train":
        agent = train(env, STEPS)
        agent.save(folder)
    else:
        agent = load(folder, env)
    observations = collect(make_env(case.environment, embedding))
    np.save(folder / f"{part}.npy", agent.act(observations))


def run_case(case: Case, folder: Path) -> dict[str, str]:
    """Run both parts of a case and return its row."""
    package = VERSIONS.get(case.library, "torch")
    row = dict(zip(COLUMNS, (case.library, version(package), case.algorithm), strict=False))
    row |= {"environment": case.environment, "wrapper": case.wrapper, "trained": "no"}
    row |= {"saved-and-loaded equal": "no"}
    embedding, work = make_embedding(case.environment, folder), Path(tempfile.mkdtemp(dir=folder))
    optimise = ["-O"] if case.environment == FETCH else []
    for part in ("train", "load"):
        command = [sys.executable, *optimise, __file__, "--part", part, str(embedding), str(work), case.key]
        done = subprocess.run(command, capture_output=True, text=True, cwd=work, check=False)
        if done.returncode:
            print(f"{case.key}, {part}: {done.stderr[-2000:]}", file=sys.stderr)
            return row
        row["trained"] = f"{STEPS} steps"
    same = np.array_equal(*(np.load(work / "0" / f"{part}.npy") for part in ("train", "load")))
    return row | {"saved-and-loaded equal": "yes" if same else "no"}


VERSIONS = {name: name for name in LIBRARIES if " " not in name}
"""The package of each library; an own loop shows the version of PyTorch."""


def is_installed(case: Case) -> bool:
    """Whether the library is installed, and gymnasium-robotics where the environment needs it."""
    needed = [VERSIONS.get(case.library, "torch")]
    if case.environment in (MAZE, FETCH):
        needed.append("gymnasium-robotics")
    try:
        return all(bool(version(name)) for name in needed)
    except PackageNotFoundError:
        return False


def print_table(rows: list[dict[str, str]]) -> None:
    print("| " + " | ".join(COLUMNS) + " |")
    print("|" + "---|" * len(COLUMNS))
    for row in rows:
        print("| " + " | ".join(row[column] for column in COLUMNS) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", default="", help="run the cases whose LIBRARY:ALGORITHM:ENVIRONMENT has this"
    )
    parser.add_argument("--part", nargs="+", help="train or load, EMBEDDING, FOLDER, and the cases to run")
    arguments = parser.parse_args()
    by_key = {case.key: case for case in CASES}
    if arguments.part:
        part, embedding, folder, *keys = arguments.part
        for i, key in enumerate(keys):
            run_part(part, by_key[key], embedding, Path(folder) / str(i))
        return
    known = {Case(r["library"], r["algorithm"], r["environment"]).key: r for r in read_rows(FILE)}
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as folder:
        for key, case in by_key.items():
            if arguments.only in key and is_installed(case):
                known[key] = run_case(case, Path(folder))
                print(key, known[key]["trained"], known[key]["saved-and-loaded equal"], file=sys.stderr)
                write_rows(FILE, COLUMNS, [known[k] for k in by_key if k in known])
    print_table([known[k] for k in by_key if k in known])


if __name__ == "__main__":
    main()
