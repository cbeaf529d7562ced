"""Training: one arm (task, algorithm, observation), all its seeds in one program."""

import contextlib
import re
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax.random as jr
import numpy as np

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.envs.episodes import make_episodes
from planspace.envs.plan_starts import own_starts
from planspace.progress import progress as progress_bar
from planspace.progress import progress_shown
from planspace.rl.algorithm import Algorithm, Diverged
from planspace.rl.arm import Arm
from planspace.rl.checks import (
    all_finite,
    check_env_workers,
    check_uses_of_plans,
    checked_names,
    checked_network,
    checked_rollout,
    checked_state,
    checked_update,
)
from planspace.rl.config import TrainConfig
from planspace.rl.evaluation import evaluate
from planspace.rl.export import export_policies
from planspace.rl.history import (
    COMMON,
    EVALUATION,
    HISTORY,
    SUCCESS,
    finite_or_none,
    load_history,
    scalars,
    with_row,
)
from planspace.rl.observe import Observer
from planspace.rl.plans import Plans
from planspace.rl.policy_network import Actor, PolicyNetwork
from planspace.rl.progress import Progress
from planspace.rl.rollout import episode_returns
from planspace.rl.run_setup import as_embeddings, embedding_of_seeds, run_settings, with_algorithm
from planspace.rl.saved_policy import DESCRIPTION
from planspace.rl.shaping import Shaping
from planspace.rl.trained import TemporaryFolder, TrainedPolicies
from planspace.storage.arrays import Arrays, read_arrays, write_arrays
from planspace.storage.checkpoint import FILE, load_checkpoint, save_checkpoint
from planspace.storage.rows import append_rows
from planspace.storage.runs import lock_folder, open_run
from planspace.storage.tracking import TrackerName, open_trackers
from planspace.tasks.action_repeat import repeat_actions, single_actions
from planspace.tasks.gymnasium import AnyTask, find_training_task
from planspace.tasks.observation_types import find_name
from planspace.tasks.stored_task import save_task
from planspace.tasks.task import Task
from planspace.tasks.task_hash import with_todays_hash
from planspace.workers import count_cores

CHECKPOINT_EVERY = 10
"""Iterations between checkpoints."""
CLONE_STREAM = 2**31
"""Distinguishes the random key of cloning from those of iterations."""
EVALUATED = (EVALUATION, SUCCESS)
"""Numbers of the history that evaluations give."""


class _State(NamedTuple):
    """Everything that changes from one iteration to the next.

    Every iteration starts from fresh episodes and from random streams made of seed and iteration, so neither
    physics nor random states belong here.
    """

    agents: tuple[Any, ...]
    """The algorithm's state of each seed."""
    frozen: np.ndarray
    """Whether each seed has produced a number that is not finite. A frozen seed acts, but is not updated."""
    history: Arrays
    """`COMMON` and the algorithm's own numbers [iteration, seed], and `EVALUATED` [evaluation, seed]; NaN
    for iterations that have not run yet."""


@dataclass(frozen=True)
class _Training:
    """Everything that does not change during training."""

    arm: Arm
    threads: ThreadPoolExecutor
    """The seeds are updated in these threads."""

    @property
    def algorithm(self) -> Algorithm:
        return self.arm.config.algorithm


def train_policies(  # noqa: PLR0913 - the public call, all but two arguments by keyword
    task: str | Path | AnyTask,
    config: TrainConfig | None = None,
    *,
    algorithm: Algorithm | str | None = None,
    embedding: Embedding | str | Path | Sequence[Embedding | str | Path] | None = None,
    plans: Demos | str | Path | None = None,
    out: str | Path | None = None,
    track: TrackerName | Sequence[TrackerName] = (),
    env_workers: int = 0,
    verbose: bool = True,
) -> TrainedPolicies:
    """Train policies on a task, all seeds at once.

    The same call continues an interrupted run bit for bit, and loads a finished one. The result of a seed
    does not depend on the other seeds.

    Args:
        task: a task, the name of a shipped one, the path of a problem file (`.yaml`), or a Gymnasium
            environment as `gym:ID` or `GymTask`.
        config: settings; by default 5 seeds of TRPO.
        algorithm: an algorithm of `planspace.rl.algorithms.PRESETS`, its name, or your own `Algorithm`;
            replaces that of `config`.
        embedding: the embedding that computes z, if `config` uses z, or its folder or name. Of a sequence of
            n embeddings, seed `s` uses the one with index `s` modulo n.
        plans: plans of the task's joints and model, or the folder of a dataset, if `config` has `resets`,
            `replay`, `clone` or `clone_weight`.
        out: the run's folder; without it, policies are stored in a temporary folder.
        track: also send the learning curves to `tensorboard` or `wandb`.
        env_workers: number of processes that step a Gymnasium environment; 0 steps it in this process. The
            results are the same. planspace's own tasks have none, because they are one batch of physics.
        verbose: show the progress.

    Raises:
        PlanspaceError: the folder holds a run with other settings, or cannot be written.
        UsageError: settings, task, algorithm, embedding and plans do not fit together.
    """
    config = with_algorithm(config or TrainConfig(), algorithm)
    task = repeat_actions(find_training_task(task), config.action_repeat)
    check_uses_of_plans(config)
    check_env_workers(task, env_workers)
    find_name(f"reward type of {task.name}", config.task_reward, task.reward_types)
    find_name(f"observation type of {task.name}", config.obs, task.obs_types)
    given = as_embeddings(embedding)
    per_seed = embedding_of_seeds(given, config)
    observed = per_seed if config.z != "none" else ()
    observer = Observer(task, config.obs, config.z, config.z_to, observed, config.num_seeds, config.goal)
    shaping, progress = Shaping.of(config, task, per_seed), Progress.of(config, task, per_seed)
    used = Plans.of(config, observer, plans, progress)
    num = config.num_seeds * num_episodes(task, config.batch_steps)
    temporary = TemporaryFolder() if out is None else None
    run = temporary.path if temporary else Path(str(out))
    with lock_folder(run):
        settings = run_settings(task, config, given, used)
        open_run(run, settings, update=partial(with_todays_hash, task=single_actions(task)))
        save_task(task, run)
        if (run / HISTORY).exists() and (run / DESCRIPTION).exists():
            history = load_history(run, (config.iterations, config.num_seeds))
        else:
            episodes = make_episodes(task, num, config.task_reward, env_workers)
            with contextlib.closing(episodes), progress_shown(verbose):
                arm = Arm(config, observer, episodes, shaping, progress)
                trackers = (track,) if isinstance(track, str) else track
                history = _train(arm if used is None else _with_plans(arm, used), given, run, trackers)
    return TrainedPolicies(task.name, config, history, run, temporary)


def _with_plans(arm: Arm, plans: Plans) -> Arm:
    """The arm with the starts and transitions that it takes from plans."""
    return replace(arm, episodes=plans.episodes(arm.episodes), plan_transitions=plans.transitions())


def num_episodes(task: AnyTask, batch_steps: int) -> int:
    """Number of environments per seed: the number of whole episodes closest to `batch_steps`."""
    return max(1, round(batch_steps / single_actions(task).horizon))


def _train(arm: Arm, embeddings: tuple[Embedding, ...], out: Path, track: Sequence[TrackerName]) -> Arrays:
    config = arm.config
    with ThreadPoolExecutor(min(count_cores(), config.num_seeds)) as threads:
        training = _Training(arm, threads)
        state, first = _init(training), 0
        if (out / FILE).exists():
            state = _with_numbers(training, *_as_saved(state, out / FILE))
            saved = load_checkpoint(out, state)
            assert saved is not None
            state, first = saved[0], saved[1]["iteration"]
        elif config.clone:
            state = _cloned(training, state)
        state = _run(training, state, first, out, track)
    history = {
        "steps": arm.env_steps * np.arange(1, config.iterations + 1),
        "eval_steps": arm.env_steps * np.array(config.evaluations),
        **{key: np.asarray(value) for key, value in state.history.items()},
    }
    export_policies(out, arm, _networks(training, state), embeddings, history[EVALUATION][-1].tolist())
    write_arrays(out / HISTORY, history)
    return history


def _init(training: _Training) -> _State:
    arm, config = training.arm, training.arm.config
    agents = tuple(checked_state(training.algorithm.init(arm, key=jr.key(seed))) for seed in config.seeds)
    names = EVALUATED if isinstance(arm.task, Task) else (EVALUATION,)
    room = {name: np.full((len(config.evaluations), config.num_seeds), np.nan) for name in names}
    state = _State(agents, np.zeros(config.num_seeds, bool), room)
    return _with_numbers(training, state, COMMON)


def _cloned(training: _Training, state: _State) -> _State:
    """Have every policy imitate the controls of plans before training."""
    arm, algorithm = training.arm, training.algorithm

    def clone(i: int) -> Any:
        key, before = jr.fold_in(jr.key(arm.config.seeds[i]), CLONE_STREAM), state.agents[i]
        cloned = algorithm.clone(arm, before, key=key)  # pyright: ignore  `check_uses_of_plans` found it
        return checked_state(checked_update((cloned, {}), before, "clone")[0], "clone")

    return state._replace(agents=tuple(training.threads.map(clone, range(arm.config.num_seeds))))


def _with_numbers(training: _Training, state: _State, names: Sequence[str]) -> _State:
    """Add a history of NaN [iteration, seed] for each name."""
    config = training.arm.config
    room = {name: np.full((config.iterations, config.num_seeds), np.nan) for name in names}
    return state._replace(history={**room, **state.history})


def _run(training: _Training, state: _State, first: int, out: Path, track: Sequence[TrackerName]) -> _State:
    config, steps, done = training.arm.config, training.arm.env_steps, first
    saved = first
    with (
        open_trackers(track, out) as add_scalars,
        progress_bar(f"train {out.name}", config.iterations, done=first, unit="iteration") as bar,
    ):

        def save() -> None:
            rows = {i + 1: _row(state.history, config, i) for i in range(saved, done)}
            for i, row in rows.items():
                add_scalars(i * steps, scalars(row, config.seeds))
            append_rows(out / "log.jsonl", _log_rows(rows), key="iteration")
            save_checkpoint(out, state, {"iteration": done})

        try:
            while done < config.iterations:
                new = _iterate(training, state, done)
                if done + 1 in config.evaluations:
                    new = _evaluate(training, new, config.evaluations.index(done + 1))
                state, done = new, done + 1  # in one statement, so that an interrupt changes both or neither
                if done % CHECKPOINT_EVERY == 0 or done == config.iterations:
                    save()
                    saved = done
                bar.update()
                latest = float(np.mean(state.history["return"][done - 1]))
                bar.set_postfix_str(f"return {latest:.1f}", refresh=False)
        except KeyboardInterrupt:
            if done > saved:
                save()
            raise
    return state


def _row(history: Arrays, config: TrainConfig, i: int) -> dict[str, list[float]]:
    """The numbers of one iteration, including those of an evaluation after it."""
    row = {key: numbers[i].tolist() for key, numbers in history.items() if key not in EVALUATED}
    if i + 1 in config.evaluations:
        number = config.evaluations.index(i + 1)
        row |= {key: history[key][number].tolist() for key in EVALUATED if key in history}
    return row


def _log_rows(rows: dict[int, dict[str, list[float]]]) -> list[dict[str, Any]]:
    """Rows of the log, by the number of their iteration."""
    return [
        {"iteration": i, "saved": time.time()}
        | {key: finite_or_none(numbers) for key, numbers in row.items()}
        for i, row in rows.items()
    ]


def _iterate(training: _Training, state: _State, iteration: int) -> _State:
    config = training.arm.config
    arm = training.arm.at(iteration / config.iterations)
    rngs = [np.random.default_rng(np.random.SeedSequence([seed, iteration])) for seed in config.seeds]
    rollout = checked_rollout(training.algorithm.collect(arm, state.agents, rngs), arm)
    parts = [rollout.of_seed(i) for i in range(config.num_seeds)]

    def update(i: int) -> tuple[Any, dict[str, float] | None]:
        key = jr.fold_in(jr.key(config.seeds[i]), 1 + iteration)
        before = state.agents[i]
        if state.frozen[i]:
            return before, None
        try:
            after, numbers = checked_update(training.algorithm.update(arm, before, parts[i], key=key), before)
        except Diverged:
            return before, None
        return (after, numbers) if all_finite(after) else (before, None)

    agents, found = zip(*training.threads.map(update, range(config.num_seeds)), strict=True)
    frozen = np.array([numbers is None for numbers in found])
    state = _with_new_numbers(training, state, [numbers for numbers in found if numbers is not None])
    row = {
        name: np.array([np.nan if numbers is None else numbers[name] for numbers in found])
        for name in state.history
        if name not in (*COMMON, *EVALUATED)
    }
    row["return"], row["length"] = episode_returns(rollout)
    row["frozen"] = frozen.astype(float)
    return _State(agents, frozen, with_row(state.history, row, iteration))


def _as_saved(state: _State, checkpoint: Path) -> tuple[_State, list[str]]:
    """The state with those numbers of evaluations that a checkpoint holds, and its other numbers' names."""
    matches = [re.fullmatch(r"\.history\['(\w+)'\]", name) for name in read_arrays(checkpoint)]
    names = [match[1] for match in matches if match is not None]
    kept = {name: numbers for name, numbers in state.history.items() if name in names}
    return state._replace(history=kept), [name for name in names if name not in EVALUATED]


def _with_new_numbers(training: _Training, state: _State, found: list[dict[str, float]]) -> _State:
    """Add the algorithm's own numbers to the history when they are first known; later check their names."""
    known = tuple(name for name in state.history if name not in (*COMMON, *EVALUATED))
    if found and not known:
        known = tuple(found[0])
        checked_names(found, known, (*COMMON, *EVALUATED))
        return _with_numbers(training, state, known)
    checked_names(found, known, (*COMMON, *EVALUATED))
    return state


def _evaluate(training: _Training, state: _State, number: int) -> _State:
    """Play an episode in each environment without exploration."""
    arm = training.arm
    deterministic = [replace(network, log_std=None) for network in _networks(training, state)]
    actor = Actor(deterministic, arm.observer.policy_columns)
    found = evaluate(own_starts(arm.episodes), arm.observer, actor, arm.config.num_seeds)
    row = {EVALUATION: found.returns, SUCCESS: found.success}
    return state._replace(
        history=with_row(state.history, {name: row[name] for name in row if name in state.history}, number)
    )


def _networks(training: _Training, state: _State) -> list[PolicyNetwork]:
    arm = training.arm
    return [checked_network(training.algorithm.act(arm, agent), arm) for agent in state.agents]
