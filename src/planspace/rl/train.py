"""Training: one arm (task, algorithm, observation), all its seeds in one program."""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax.random as jr
import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import DESCRIPTION, Embedding
from planspace.envs.batch import TaskBatch
from planspace.errors import UsageError
from planspace.progress import progress
from planspace.rl.advantage import discounted_returns, gae
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.rl.history import (
    EVALUATION,
    HISTORY,
    HISTORY_KEYS,
    load_history,
    scalars,
    with_row,
    without_nan,
)
from planspace.rl.learner import Learner, learn, make_learner, values
from planspace.rl.mlp import stacked_layers
from planspace.rl.normalise import ObsStatistics
from planspace.rl.observe import Observer
from planspace.rl.rollout import Actor, collect, episode_returns, first_returns
from planspace.rl.saved_policy import EMBEDDING, save_policies
from planspace.rl.shaping import Shaping
from planspace.storage.arrays import Arrays, write_arrays
from planspace.storage.checkpoint import load_checkpoint, save_checkpoint
from planspace.storage.provenance import Provenance
from planspace.storage.rows import append_rows
from planspace.storage.runs import open_run
from planspace.storage.tracking import TrackerName, open_trackers
from planspace.tasks.catalog import find_task
from planspace.tasks.task import Task, find_reward_type
from planspace.workers import count_cores

CHECKPOINT_EVERY = 10
"""Iterations between checkpoints."""
EVALUATION_SEED = 20_201_026
"""Evaluations start where this stream says: every seed of every arm is asked the same."""


class _State(NamedTuple):
    """Everything that changes from one iteration to the next.

    Every iteration starts from fresh episodes and from streams made of seed and iteration, so neither
    physics nor random states belong here.
    """

    learners: tuple[Learner, ...]
    """One a seed."""
    history: dict[str, Any]
    """Each of `HISTORY_KEYS` as [iteration, seed], `EVALUATION` as [evaluation, seed]; filled as far as the
    run has come."""


@dataclass(frozen=True)
class _Arm:
    """Everything that stays as it is."""

    config: TrainConfig
    observer: Observer
    batch: TaskBatch
    threads: ThreadPoolExecutor
    """The seeds learn side by side in these."""
    shaping: Shaping | None = None

    @property
    def steps(self) -> int:
        """Steps an iteration and seed: an episode's length in each of its environments."""
        return num_episodes(self.batch.task) * self.batch.task.horizon


def train(
    config: TrainConfig,
    out: Path,
    embeddings: Sequence[Embedding] = (),
    track: Sequence[TrackerName] = (),
) -> Arrays:
    """Trains all seeds of an arm at once.

    The same call continues an interrupted run bit for bit, and returns a finished one's history. What a seed
    does and learns does not depend on the seeds beside it.

    Args:
        config: the arm.
        out: the run's folder.
        embeddings: what makes z, for an arm that has it: one, or several that the seeds take in turn (seed
            `s` takes number `s` modulo how many there are).
        track: where the curves are to be shown beside the history.

    Returns:
        The history: `steps` [iteration], each of `HISTORY_KEYS` [iteration, seed], `eval_steps` [evaluation]
        and `eval_return` [evaluation, seed]. A seed that came upon numbers that are not finite is `frozen`
        from there on: its returns go on as those of the policy it had.

    Raises:
        PlanspaceError: the folder holds a run with other settings, or cannot be written.
        UsageError: the parts of the arm do not fit.
    """
    task = find_task(config.task)
    find_reward_type(config.reward, task)
    given = tuple(embeddings)
    dealt = _dealt(given, config)
    seen = dealt if config.z != "none" else ()
    observer = Observer(task, config.obs, config.z, config.z_to, seen, config.num_seeds)
    shaping = Shaping.of(config, dealt)
    open_run(out, _settings(config, given))
    if (out / HISTORY).exists():
        return load_history(out, (config.iterations, config.num_seeds))
    batch = TaskBatch(task, config.num_seeds * num_episodes(task), reward=config.reward)
    with ThreadPoolExecutor(min(count_cores(), config.num_seeds)) as threads:
        arm = _Arm(config, observer, batch, threads, shaping)
        state, first = _init(arm), 0
        saved = load_checkpoint(out, state)
        if saved is not None:
            state, first = saved[0], saved[1]["iteration"]
        state = _run(arm, state, first, out, track)
    history = {
        "steps": arm.steps * np.arange(1, config.iterations + 1),
        "eval_steps": arm.steps * np.array(config.evaluations),
        **{key: np.asarray(value) for key, value in state.history.items()},
    }
    _save_policies(arm, given, state, out)
    write_arrays(out / HISTORY, history)
    return history


def num_episodes(task: Task) -> int:
    """Environments a seed: as many whole episodes as come nearest to `BATCH_STEPS`."""
    return max(1, round(BATCH_STEPS / task.horizon))


def _dealt(embeddings: tuple[Embedding, ...], config: TrainConfig) -> tuple[Embedding, ...]:
    """The embeddings as the seeds take them."""
    if embeddings and not config.needs_embedding:
        raise UsageError(
            "an embedding was given, but z is 'none': give --z augment, --z replace or --shaping z."
        )
    if len(embeddings) <= 1:
        return embeddings
    if len(embeddings) > config.num_seeds:
        raise UsageError(f"{len(embeddings)} embeddings are too many for {config.num_seeds} seeds.")
    return tuple(embeddings[seed % len(embeddings)] for seed in config.seeds)


def _settings(config: TrainConfig, embeddings: tuple[Embedding, ...]) -> dict[str, Any]:
    return {
        **asdict(config),
        "learner": asdict(config.learns),
        "embeddings": [embedding.hash for embedding in embeddings],
        "versions": Provenance.current("mujoco", "jax").plain(),
    }


def _init(arm: _Arm) -> _State:
    config = arm.config
    num_actions = len(arm.batch.simulator.control_low)
    learners = tuple(
        make_learner(config, arm.observer, num_actions, key=jr.key(seed)) for seed in config.seeds
    )
    shape = (config.iterations, config.num_seeds)
    history = {key: np.full(shape, np.nan) for key in HISTORY_KEYS}
    history[EVALUATION] = np.full((len(config.evaluations), config.num_seeds), np.nan)
    return _State(learners, history)


def _run(arm: _Arm, state: _State, first: int, out: Path, track: Sequence[TrackerName]) -> _State:
    config, done = arm.config, first
    saved = first
    with (
        open_trackers(track, out) as add_scalars,
        progress(f"train {out.name}", config.iterations, done=first, unit="iteration") as bar,
    ):

        def save() -> None:
            rows = []
            for i in range(saved, done):
                row = {key: state.history[key][i].tolist() for key in HISTORY_KEYS}
                if i + 1 in config.evaluations:
                    row[EVALUATION] = state.history[EVALUATION][config.evaluations.index(i + 1)].tolist()
                rows.append({"iteration": i + 1, "saved": time.time(), **without_nan(row)})
                add_scalars((i + 1) * arm.steps, scalars(row, config.seeds))
            append_rows(out / "log.jsonl", rows, key="iteration")
            save_checkpoint(out, state, {"iteration": done})

        try:
            while done < config.iterations:
                new = _iterate(arm, state, done)
                if done + 1 in config.evaluations:
                    new = _evaluate(arm, new, config.evaluations.index(done + 1))
                state, done = new, done + 1  # together, so that an interrupt finds both or neither
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


def _iterate(arm: _Arm, state: _State, iteration: int) -> _State:
    config, learner = arm.config, arm.config.learns
    rngs = [np.random.default_rng(np.random.SeedSequence([seed, iteration])) for seed in config.seeds]
    actor = _actor(arm, state)
    rollout = collect(arm.batch, arm.observer, actor, arm.batch.task.horizon, rngs, shape=arm.shaping)
    parts = [rollout.of_seed(i) for i in range(config.num_seeds)]

    def ask(i: int) -> tuple[np.ndarray, np.ndarray]:
        return values(state.learners[i], parts[i], arm.observer, config)

    asked = arm.threads.map(ask, range(config.num_seeds))
    value, next_value = (np.stack(x, axis=1) for x in zip(*asked, strict=True))
    ends = (rollout.terminated, rollout.timeout | rollout.cut)
    paid = rollout.rewards + rollout.shaping
    rewards = paid + learner.entropy_reward * actor.entropy[None, :, None]
    with np.errstate(invalid="ignore", over="ignore"):  # `learn` looks whether all is finite
        advantages = gae(
            rewards, value, next_value, *ends, discount=learner.discount, trace=learner.gae_lambda
        )
        returns = discounted_returns(paid, next_value, *ends, discount=learner.discount)

    def teach(i: int) -> tuple[Learner, dict[str, float]]:
        key = jr.fold_in(jr.key(config.seeds[i]), 1 + iteration)
        shares = advantages[:, i], returns[:, i]
        return learn(state.learners[i], parts[i], *shares, arm.observer, config, key=key)

    learners, updates = zip(*arm.threads.map(teach, range(config.num_seeds)), strict=True)
    row = {name: np.array([update[name] for update in updates]) for name in updates[0]}
    row["return"], row["length"] = episode_returns(rollout)
    with np.errstate(invalid="ignore"):
        shares = zip(np.moveaxis(returns, 1, 0), np.moveaxis(value, 1, 0), strict=True)
        row["explained_variance"] = np.array([_explained_variance(*share) for share in shares])
    row["frozen"] = np.array([float(x.frozen) for x in learners])
    return _State(learners, with_row(state.history, row, iteration))


def _evaluate(arm: _Arm, state: _State, number: int) -> _State:
    """Plays an episode in each environment, each action the policy's mean."""
    rngs = [np.random.default_rng(EVALUATION_SEED) for _ in arm.config.seeds]
    horizon = arm.batch.task.horizon
    rollout = collect(arm.batch, arm.observer, _actor(arm, state), horizon, rngs, noise=False)
    row = {EVALUATION: first_returns(rollout)}
    return _State(state.learners, with_row(state.history, row, number))


def _actor(arm: _Arm, state: _State) -> Actor:
    statistics = [x.statistics for x in state.learners] if arm.config.learns.normalise_obs else None
    return Actor([x.policy for x in state.learners], arm.observer.policy_columns, statistics)


def _explained_variance(
    returns: Float[np.ndarray, "time env"], value: Float[np.ndarray, "time env"]
) -> float:
    """How much of the returns' variance the critic knew beforehand."""
    returns, value = np.ascontiguousarray(returns), np.ascontiguousarray(value)  # sums in one order
    return float(1.0 - np.var(returns - value) / max(np.var(returns), 1e-12))


def _save_policies(arm: _Arm, embeddings: tuple[Embedding, ...], state: _State, out: Path) -> None:
    """Leaves the policies, and what makes z, where `load_policy` finds them."""
    config, observer = arm.config, arm.observer
    folders = [EMBEDDING] if len(embeddings) == 1 else [f"{EMBEDDING}-{i}" for i in range(len(embeddings))]
    if config.needs_embedding:
        for embedding, folder in zip(embeddings, folders, strict=True):
            if not (out / folder / DESCRIPTION).exists():
                embedding.save(out / folder)
    networks = [x.policy.mean for x in state.learners]
    weights, biases = stacked_layers(networks)
    arrays = {f"{n}.weight": weight for n, weight in enumerate(weights)}
    arrays |= {f"{n}.bias": bias for n, bias in enumerate(biases)}
    arrays["log_std"] = np.stack([np.asarray(x.policy.log_std) for x in state.learners])
    if config.learns.normalise_obs:
        arrays |= ObsStatistics.stacked([x.statistics for x in state.learners])._asdict()
    columns = observer.policy_columns
    about = {
        "task": config.task,
        "env_id": observer.task.env_id,
        "obs": config.obs,
        "reward": config.reward,
        "z": config.z,
        "z_to": config.z_to,
        "num_obs": observer.num_obs,
        "columns": [columns.start, columns.stop],
        "layer_norm": networks[0].layer_norm,
        "seeds": list(config.seeds),
        "embeddings": [folders[seed % len(folders)] for seed in config.seeds if config.needs_embedding],
        **without_nan(
            {
                "action_low": arm.batch.simulator.control_low.tolist(),
                "action_high": arm.batch.simulator.control_high.tolist(),
                "returns": state.history[EVALUATION][-1].tolist(),
            }
        ),
        "versions": Provenance.current().plain(),
    }
    save_policies(out, arrays, about)
