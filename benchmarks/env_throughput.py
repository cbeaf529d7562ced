"""Speed of the environments: ours beside bare physics, Gymnasium's vector environments and wrappers.

    python benchmarks/env_throughput.py [--task cartpole-swingup] [--rounds 5] [--num-envs 64 600 4096]

Environment steps a second, each round of which times everything in turn; medians, and the median (least to
greatest) of each round's ratio to ours at the same number of environments. Bare physics is `mujoco.batch`
stepping the same episodes, with nothing observed or rewarded.
"""

import argparse
import time
from collections.abc import Callable

import gymnasium
import mujoco.batch
import numpy as np

from planspace.envs.vector import TaskVectorEnv
from planspace.tasks import Task, find_task

SECONDS = 1.0
"""About how long each measurement takes."""


def bare(task: Task, num: int, states: np.ndarray, actions: np.ndarray) -> Callable[[], None]:
    """Steps the physics alone, through the same episodes."""
    model, space = task.compile()
    batch = mujoco.batch.Batch(model, num, 0)
    qpos, qvel, ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
    ctrl[:] = actions
    space.write(states, qpos, qvel)
    elapsed = 0

    def step() -> None:
        nonlocal elapsed
        batch.step(nstep=task.frame_skip)
        elapsed += 1
        if elapsed % task.horizon == 0:
            space.write(states, qpos, qvel)

    return step


def stepping(env: gymnasium.vector.VectorEnv, actions: np.ndarray) -> Callable[[], None]:
    env.reset(seed=0)
    return lambda: env.step(actions) and None


def rate(step: Callable[[], None], num: int) -> float:
    """Environment steps a second, timed for about `SECONDS`."""
    calls = max(1, int(SECONDS / timed(step, 10) * 10))
    return num * calls / timed(step, calls)


def timed(step: Callable[[], None], calls: int) -> float:
    began = time.perf_counter()
    for _ in range(calls):
        step()
    return time.perf_counter() - began


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
    print(f"{'steps a second':<44}{'median':>12}{'over ours':>24}")
    for num in arguments.num_envs:
        ours = TaskVectorEnv(task.name, num)
        ours.action_space.seed(0)
        actions = ours.action_space.sample()
        kinds = {"ours": stepping(ours, actions), "bare physics": bare(task, num, ours.states, actions)}
        others = []
        if num <= 64:  # a process each, or a Python loop over as many objects
            for mode in ("sync", "async"):
                env = gymnasium.make_vec(task.env_id, num_envs=num, vectorization_mode=mode)
                kinds[f"Gymnasium's {mode}"] = stepping(env, actions)
                others.append(env)
        rows = [{name: rate(step, num) for name, step in kinds.items()} for _ in range(arguments.rounds)]
        for name in kinds:
            values = np.array([row[name] for row in rows])
            ratio = values / np.array([row["ours"] for row in rows])
            spread = f"{np.median(ratio):.3f} ({ratio.min():.3f} to {ratio.max():.3f})"
            print(f"{f'{num} environments, {name}':<44}{np.median(values):>12,.0f}{spread:>24}", flush=True)
        for env in others:
            env.close()


if __name__ == "__main__":
    main()
