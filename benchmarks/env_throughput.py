"""Measure the speed of environments and wrappers.

    python benchmarks/env_throughput.py [--task cartpole-swingup] [--rounds 5] [--num-envs 64 600 4096]

The first table compares planspace's vector environment with bare physics and with the vector environments of
Gymnasium and SB3, in environment steps per second. Bare physics is `mujoco.batch` that steps the same
episodes without observations or rewards. The second table shows the time that the wrappers add to a step,
with a random embedding of the default architecture (2 x 64 units, z of 3 dimensions, sin and cos of the
angle).

Every round times all rows one after another. The tables show medians, and the median, minimum and maximum of
the ratio to, or difference from, the first row of the same round.
"""

import argparse
import importlib.util
import itertools
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import gymnasium
import mujoco.batch
import numpy as np

from planspace.embed.embedding import Embedding, LinearMap
from planspace.embed.inputs import Inputs
from planspace.envs.vector import TaskVectorEnv
from planspace.envs.wrappers import (
    PlanSpaceObservation,
    PlanSpaceShaping,
    PlanSpaceVectorObservation,
    PlanSpaceVectorShaping,
)
from planspace.tasks.catalog import find_task
from planspace.tasks.task import Task

SECONDS = 1.0
"""Approximate duration of one measurement."""


def bare(task: Task, num: int, states: np.ndarray, actions: np.ndarray) -> Callable[[], None]:
    """A function that steps only the physics, through the same episodes."""
    model, space = task.compile()
    batch = mujoco.batch.Batch(model, num, 0)
    qpos, qvel, ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
    act = batch.bind("act")
    ctrl[:] = actions
    space.write(states, qpos, qvel, act)
    elapsed = 0

    def step() -> None:
        nonlocal elapsed
        batch.step(nstep=task.frame_skip)
        elapsed += 1
        if elapsed % task.horizon == 0:
            space.write(states, qpos, qvel, act)

    return step


def stepping(env: gymnasium.vector.VectorEnv, actions: np.ndarray) -> Callable[[], None]:
    env.reset(seed=0)
    return lambda: env.step(actions) and None


def rate(step: Callable[[], None], num: int) -> float:
    """Environment steps per second, measured for about `SECONDS`."""
    calls = max(1, int(SECONDS / timed(step, 10) * 10))
    return num * calls / timed(step, calls)


def timed(step: Callable[[], None], calls: int) -> float:
    began = time.perf_counter()
    for _ in range(calls):
        step()
    return time.perf_counter() - began


def make_embedding(task: Task, folder: Path) -> Path:
    """Save an embedding of the task's states with random weights and the default architecture."""
    rng, space = np.random.default_rng(0), task.compile()[1]
    inputs = Inputs.fit(
        rng.normal(size=(9, space.size)), space.names, space.units, space.circular_columns, "trig"
    )

    def layers(*sizes: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
        weights = [rng.normal(size=(b, a)).astype(np.float32) for a, b in itertools.pairwise(sizes)]
        return weights, [np.zeros(len(w), np.float32) for w in weights]

    num = len(inputs.columns)
    turn = LinearMap(np.eye(3, dtype=np.float32), np.zeros(3, np.float32))
    Embedding(inputs, layers(num, 64, 64, 6), layers(3, 64, 64, 2 * num), 0.0, turn).save(
        folder / "embedding"
    )
    return folder / "embedding"


def sb3_environments(task: Task, num: int) -> dict[str, object]:
    """The vector environments of planspace and of SB3; empty if SB3 is not installed."""
    if importlib.util.find_spec("stable_baselines3") is None:
        return {}
    from stable_baselines3.common.vec_env import SubprocVecEnv

    from planspace.envs.sb3 import make_vec_env

    make = partial(gymnasium.make, task.env_id)
    return {
        "planspace for SB3": make_vec_env(task.env_id, num),
        "SB3's SubprocVecEnv": SubprocVecEnv([make] * num),
    }


def compare(kinds: dict[str, Callable[[], None]], num: int, rounds: int) -> None:
    """Time all rows in turn and print them with their ratio to the first."""
    first = next(iter(kinds))
    rows = [{name: rate(step, num) for name, step in kinds.items()} for _ in range(rounds)]
    for name in kinds:
        values = np.array([row[name] for row in rows])
        ratio = values / np.array([row[first] for row in rows])
        spread = f"{np.median(ratio):.3f} ({ratio.min():.3f} to {ratio.max():.3f})"
        print(f"{f'{num} environments, {name}':<44}{np.median(values):>12,.0f}{spread:>24}", flush=True)


def throughput(task: Task, num: int, rounds: int) -> None:
    """Compare planspace with bare physics and other vector environments."""
    ours = TaskVectorEnv(task.name, num)
    ours.action_space.seed(0)
    actions = ours.action_space.sample()
    kinds = {"planspace": stepping(ours, actions), "bare physics": bare(task, num, ours.states, actions)}
    others = []
    if num <= 600:  # others need an object, or even a process, per environment
        for mode in ("sync", "async") if num <= 64 else ("sync",):
            others.append(gymnasium.make_vec(task.env_id, num_envs=num, vectorization_mode=mode))
            kinds[f"Gymnasium's {mode}"] = stepping(others[-1], actions)
        for name, env in sb3_environments(task, num).items() if num <= 64 else ():
            others.append(env)
            env.reset()
            kinds[name] = partial(env.step, actions)
    compare(kinds, num, rounds)
    for env in others:
        env.close()


def wrapper_cost(task: Task, nums: list[int], rounds: int, embedding: Path) -> None:
    """Measure the time that z and shaping add to a step, for one environment and for several."""
    goal = [0.0] * task.compile()[1].size
    print(f"\n{'microseconds per step':<44}{'median':>12}{'more than bare':>24}")
    for num in [1, *nums]:
        if num == 1:
            env = gymnasium.make(task.env_id, disable_env_checker=True, max_episode_steps=-1).unwrapped
            shown, shaped = PlanSpaceObservation(env, embedding), PlanSpaceShaping(env, embedding, goal)
        else:
            env = TaskVectorEnv(task.name, num)
            shown = PlanSpaceVectorObservation(env, embedding)
            shaped = PlanSpaceVectorShaping(env, embedding, goal)
        env.action_space.seed(0)
        actions = env.action_space.sample()
        kinds = {}
        for name, kind in {"bare": env, "with z": shown, "with shaping": shaped}.items():
            kind.reset(seed=0)
            kinds[name] = partial(kind.step, actions)
        rows = [{name: 1e6 / rate(step, 1) for name, step in kinds.items()} for _ in range(rounds)]
        for name in kinds:
            values = np.array([row[name] for row in rows])
            more = values - np.array([row["bare"] for row in rows])
            fraction = np.median(more) / np.median(values - more)
            spread = f"{np.median(more):.1f} ({more.min():.1f} to {more.max():.1f}) {fraction:4.0%}"
            print(f"{f'{num} environments, {name}':<44}{np.median(values):>12,.1f}{spread:>24}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="cartpole-swingup")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--num-envs", type=int, nargs="*", default=[64, 600, 4096])
    arguments = parser.parse_args()
    task = find_task(arguments.task)
    print(f"command: python benchmarks/env_throughput.py --task {task.name} --rounds {arguments.rounds}")
    print(f"{'steps per second':<44}{'median':>12}{'ratio to planspace':>24}")
    for num in arguments.num_envs:
        throughput(task, num, arguments.rounds)
    with tempfile.TemporaryDirectory() as folder:
        embedding = make_embedding(task, Path(folder))
        wrapper_cost(task, arguments.num_envs, arguments.rounds, embedding)


if __name__ == "__main__":
    main()
