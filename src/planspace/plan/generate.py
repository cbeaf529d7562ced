"""Many plans: seeded starts, worker processes, shards committed as they are made, resume."""

import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

import mujoco
import numpy as np

import planspace
from planspace.demos.dataset import DemoFolder, Episode, StateInfo
from planspace.errors import PartialResult
from planspace.physics.angles import unwrap_to_end
from planspace.physics.simulate import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.polish import GoalRegulator, TailConfig
from planspace.plan.problem import Problem
from planspace.plan.sst import SST, Solution, SSTConfig
from planspace.progress import progress
from planspace.store import append_row

SHARD_EPISODES = 10
"""Plans a shard: what a kill can cost, at most, beside those under way."""
MAX_ATTEMPTS = 3
"""A plan that fails is tried again from another start, this many times in all."""


@dataclass(frozen=True)
class PlannerConfig:
    """How demonstrations are planned."""

    sst: SSTConfig = field(default_factory=SSTConfig)
    """The sampling planner."""
    tail: TailConfig = field(default_factory=TailConfig)
    """The regulator that ends each plan at its goal."""


def generate(
    problem: Problem, out: Path, *, num: int, seed: int, config: PlannerConfig, workers: int | None = None
) -> DemoFolder:
    """Plans demonstrations from random starts and stores them.

    The plans already in the folder are kept; plan i depends on the problem, the settings, the seed and i
    alone, so an interrupted command ends with the same content as one that was not.

    Args:
        problem: what to plan.
        out: the dataset folder.
        num: how many plans it is to hold.
        seed: the seed of all of them.
        config: planner settings.
        workers: processes; by default one for each CPU.

    Returns:
        The folder.

    Raises:
        PlanspaceError: the folder cannot be written or holds something else.
        PartialResult: some plans failed at every attempt; the others are saved.
    """
    folder = DemoFolder(
        out,
        state_info(problem),
        {
            "problem": problem.hash,
            "seed": seed,
            "planner": "sst",
            "config": asdict(config),
            "versions": {"planspace": planspace.__version__, "mujoco": mujoco.__version__},
        },
    )
    remaining = range(folder.next_index, num)
    if remaining:
        began = time.time()
        with progress("plan", num, done=folder.next_index, unit="plan") as bar:
            batch: list[Episode] = []
            for i, episode in zip(
                remaining, _plan_all(problem, config, seed, remaining, workers), strict=True
            ):
                if episode is not None:
                    batch.append(episode)
                bar.update()
                if (i + 1) % SHARD_EPISODES == 0 or i + 1 == num:
                    folder.append(batch, i + 1)
                    append_row(out / "log.jsonl", {"time": time.time(), "planned": i + 1, "since": began})
                    batch = []
    missing = folder.next_index - folder.num_episodes
    if missing:
        raise PartialResult(
            f"{missing} of {folder.next_index} plans found no way to the goal in {MAX_ATTEMPTS} attempts; "
            f"the other {folder.num_episodes} are saved in {out}."
        )
    return folder


def state_info(problem: Problem) -> StateInfo:
    """What the states of a problem's demonstrations are."""
    model, space = problem.compile()
    return StateInfo(
        names=space.names,
        units=space.units,
        circular_columns=space.circular_columns,
        num_controls=model.nu,
        problem=problem.name,
        joints=problem.joints,
        mjcf=problem.mjcf,
    )


def plan_one(problem: Problem, config: PlannerConfig, seed: int, index: int) -> Episode | None:
    """Plans one demonstration and verifies it in plain MuJoCo.

    Returns:
        The episode, or None when every attempt failed.
    """
    model, space = problem.compile()
    simulator = Simulator(model, space, max(config.sst.extensions, 64), threads=1)
    for attempt in range(MAX_ATTEMPTS):
        rng = np.random.default_rng(np.random.SeedSequence([seed, index, attempt]))
        start, goal = problem.start.sample(rng), problem.goal.sample(rng)
        regulator = GoalRegulator(simulator, goal, np.array(problem.feature_weights), config.tail)
        solution = SST(problem, simulator, regulator, config.sst, rng).solve(start)
        if solution is None:
            continue
        recorded = record(model, problem, regulator, start, solution)
        if recorded is None:
            continue
        states, controls = recorded
        for column in space.circular_columns:
            states[:, column] = unwrap_to_end(states[:, column])
        times = np.arange(len(states)) * model.opt.timestep
        return Episode(states, controls, times, goal, success=True, index=index, seed=attempt)
    return None


def record(
    model: mujoco.MjModel,
    problem: Problem,
    regulator: GoalRegulator,
    start: np.ndarray,
    solution: Solution,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Runs a solution in plain MuJoCo from its start until it first enters the goal region.

    The regulator's controls are computed from the states met on the way, so that the record is what plain
    MuJoCo does. Afterwards the goal is held, which is checked and not recorded.

    Returns:
        T + 1 states and T controls, one for each physics step; None if the run leaves the bounds, never
        arrives, or cannot hold the goal.
    """
    space = StateSpace.from_model(model, problem.joints, velocity_bound=problem.velocity_bound)
    data = mujoco.MjData(model)
    space.write(start, data.qpos, data.qvel)
    planned = np.repeat(solution.controls, solution.durations, axis=0)
    states, controls = [np.array(start)], []
    deadline = len(planned) + regulator.config.max_steps
    while space.distance(states[-1], regulator.goal) > problem.tolerance:
        step = len(controls)
        if step >= deadline:
            return None
        controls.append(planned[step] if step < len(planned) else regulator.control(states[-1]))
        states.append(_step(model, data, space, controls[-1]))
        if not space.in_bounds(states[-1]):
            return None
    held = states[-1]
    for _ in range(regulator.config.hold_steps):
        held = _step(model, data, space, regulator.control(held))
    if not space.distance(held, regulator.goal) <= problem.tolerance:
        return None
    if not controls:  # a start inside the goal region is no demonstration
        return None
    return np.stack(states), np.stack(controls)


def _step(model: mujoco.MjModel, data: mujoco.MjData, space: StateSpace, control: np.ndarray) -> np.ndarray:
    data.ctrl[:] = control
    mujoco.mj_step(model, data)
    return space.read(data.qpos, data.qvel)


def _plan_all(
    problem: Problem, config: PlannerConfig, seed: int, indices: range, workers: int | None
) -> Iterator[Episode | None]:
    """The plans in order, made in worker processes."""
    workers = min(workers or os.cpu_count() or 1, len(indices))
    if workers == 1:
        for i in indices:
            yield plan_one(problem, config, seed, i)
        return
    context = multiprocessing.get_context("spawn")  # a fork would copy thread pools that no longer run
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_ignore_interrupt) as pool:
        futures = [pool.submit(plan_one, problem, config, seed, i) for i in indices]
        try:
            for future in futures:
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _ignore_interrupt() -> None:
    """Leaves Ctrl-C to the parent, which stops the workers after the plan they are at."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
