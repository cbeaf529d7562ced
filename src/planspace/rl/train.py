"""Training: one arm (task, algorithm, observation), all its seeds in one program."""

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import mujoco
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Key, Shaped

import planspace
from planspace.checkpoint import load_checkpoint, save_checkpoint
from planspace.embed.embedding import Embedding
from planspace.envs.batch import TaskBatch
from planspace.progress import progress
from planspace.rl import ppo, trpo
from planspace.rl.advantage import discounted_returns, gae
from planspace.rl.config import BATCH_STEPS, LearnerConfig, PPOConfig, TrainConfig, TRPOConfig
from planspace.rl.critic import Critic, make_critic
from planspace.rl.normalise import ObsStatistics
from planspace.rl.observe import Observer
from planspace.rl.policy import GaussianPolicy, UpdateInfo
from planspace.rl.rollout import Actor, Rollout, collect, episode_returns
from planspace.rl.saved_policy import EMBEDDING, save_policies
from planspace.store import Arrays, append_row, open_run, read_arrays, write_arrays
from planspace.tasks import find_task

CHECKPOINT_EVERY = 10
"""Iterations between checkpoints."""
HISTORY = "history.safetensors"
LAST = 10
"""Iterations at the end whose mean return says which seed is the best."""

HISTORY_KEYS = (
    "return",
    "length",
    "kl",
    "entropy",
    "loss",
    "improvement",
    "explained_variance",
    "skipped",
)
"""What is recorded for each iteration and seed; see `UpdateInfo` and `episode_returns`."""


class _State(eqx.Module):
    """Everything that changes from one iteration to the next, with a leading axis of seeds.

    Every iteration starts from fresh episodes and from streams made of seed and iteration, so neither
    physics nor random states belong here.
    """

    policies: GaussianPolicy
    adam: optax.OptState | None
    """Of PPO's policies; nothing for TRPO."""
    critic: Critic
    statistics: ObsStatistics
    history: dict[str, Any]
    """Each of `HISTORY_KEYS` as [iterations, seed], filled up to the current one."""


def train(config: TrainConfig, out: Path, embedding: Embedding | None = None) -> Arrays:
    """Trains all seeds of an arm at once.

    The same call continues an interrupted run bit for bit, and returns a finished one's history.

    Args:
        config: the arm.
        out: the run's folder.
        embedding: what makes z, for an arm that has it.

    Returns:
        The history: `steps` [iteration], and for each of `HISTORY_KEYS` [iteration, seed].

    Raises:
        PlanspaceError: the folder holds a run with other settings, or cannot be written.
        UsageError: the parts of the arm do not fit.
    """
    task = find_task(config.task)
    observer = Observer(task, config.obs, config.z, config.z_to, embedding)
    settings = {
        **asdict(config),
        "learner": asdict(config.learns),
        "embedding": None if embedding is None or config.z == "none" else embedding.hash,
        "versions": {
            "planspace": planspace.__version__,
            "mujoco": mujoco.__version__,
            "jax": jax.__version__,
        },
    }
    open_run(out, settings)
    if (out / HISTORY).exists():
        return read_arrays(out / HISTORY)
    batch = TaskBatch(task, config.num_seeds * (BATCH_STEPS // task.horizon))
    state = _init(config, observer, batch)
    first = 0
    saved = load_checkpoint(out, state)
    if saved is not None:
        state, first = saved[0], saved[1]["iteration"]
    state = _run(config, observer, batch, state, first, out)
    history = {
        "steps": BATCH_STEPS * np.arange(1, config.iterations + 1),
        **{key: np.asarray(value) for key, value in state.history.items()},
    }
    _save_policies(config, observer, batch, state, out)
    write_arrays(out / HISTORY, history)
    return history


def _run(
    config: TrainConfig, observer: Observer, batch: TaskBatch, state: _State, first: int, out: Path
) -> _State:
    done = saved = first
    label = f"train {out.name}"
    try:
        with progress(label, config.iterations, done=first, unit="iteration") as bar:
            while done < config.iterations:
                state = _iterate(config, observer, batch, state, done)
                done += 1
                if done % CHECKPOINT_EVERY == 0 or done == config.iterations:
                    save_checkpoint(out, state, {"iteration": done})
                    _log(out, state, saved, done)
                    saved = done
                bar.update()
                latest = float(np.mean(state.history["return"][done - 1]))
                bar.set_postfix_str(f"return {latest:.1f}", refresh=False)
    except KeyboardInterrupt:
        if done > saved:
            save_checkpoint(out, state, {"iteration": done})
            _log(out, state, saved, done)
        raise
    return state


def _iterate(
    config: TrainConfig, observer: Observer, batch: TaskBatch, state: _State, iteration: int
) -> _State:
    learner, statistics = config.learns, state.statistics
    rngs = [np.random.default_rng(np.random.SeedSequence([seed, iteration])) for seed in config.seeds]
    num_steps = BATCH_STEPS * config.num_seeds // len(batch.states)
    actor = Actor(state.policies, observer.policy_columns, statistics if learner.normalise_obs else None)
    rollout = collect(batch, observer, actor, num_steps, rngs)
    seen = _per_seed(rollout.obs)
    obs = statistics(seen) if learner.normalise_obs else seen
    value, next_value = _values(rollout, observer, state.critic, obs, statistics, learner)
    truncated = rollout.timeout | rollout.cut
    ends = (rollout.terminated, truncated)
    entropy = np.asarray(eqx.filter_vmap(lambda p: p.entropy())(state.policies))
    rewards = rollout.rewards + learner.entropy_reward * entropy[None, :, None]
    advantages = gae(rewards, value, next_value, *ends, discount=learner.discount, trace=learner.gae_lambda)
    if learner.normalise_advantages:
        mean, deviation = (
            advantages.mean(axis=(0, 2), keepdims=True),
            advantages.std(axis=(0, 2), keepdims=True),
        )
        advantages = (advantages - mean) / (deviation + 1e-8)
    keys = _keys(config, 1 + iteration)
    policies, adam, info = _learn(config, state, rollout, obs[..., observer.policy_columns], advantages, keys)
    returns = _per_seed(discounted_returns(rollout.rewards, next_value, *ends, discount=learner.discount))
    critic = state.critic.fitted(obs[..., observer.critic_columns], _per_seed(rollout.step), returns, keys)
    if learner.normalise_obs:
        statistics = statistics.with_more(seen)
    history = _record(state.history, iteration, rollout, info, returns, _per_seed(value))
    return _State(policies, adam, critic, statistics, history)


def _values(
    rollout: Rollout,
    observer: Observer,
    critic: Critic,
    obs: Float[np.ndarray, "seed sample obs"],
    statistics: ObsStatistics,
    learner: LearnerConfig,
) -> tuple[Float[np.ndarray, "time seed env"], Float[np.ndarray, "time seed env"]]:
    """The critic's value before and after each step; after a step that ends an episode for good, 0.

    The next state is mostly the next row's. Where the record was cut it is not, nor at the time limit, beyond
    which the 2020 runs took nothing to lie.
    """
    num_steps, num_seeds, _ = rollout.rewards.shape
    columns = observer.critic_columns
    value = np.moveaxis(
        critic.values(obs[..., columns], _per_seed(rollout.step)).reshape(num_seeds, num_steps, -1), 0, 1
    )
    next_value = np.zeros_like(value)
    next_value[:-1] = value[1:]
    next_value[rollout.timeout | rollout.terminated] = 0.0
    asked = _per_seed(rollout.cut | (rollout.timeout & learner.bootstrap_timeout))
    if asked.any():
        rows = _padded_rows(asked)
        after = np.take_along_axis(_per_seed(rollout.next_obs), rows[..., None], axis=1)
        after = statistics(after) if learner.normalise_obs else after
        step = np.take_along_axis(_per_seed(rollout.step), rows, axis=1) + 1
        flat = np.moveaxis(next_value, 1, 0).reshape(num_seeds, -1)  # a copy
        for s, values in enumerate(critic.values(after[..., columns], step)):
            flat[s, rows[s]] = np.where(asked[s, rows[s]], values, flat[s, rows[s]])
        next_value = np.moveaxis(flat.reshape(num_seeds, num_steps, -1), 0, 1)
    return value, next_value


def _padded_rows(mask: Bool[np.ndarray, "seed sample"]) -> np.ndarray:
    """Where each seed's row is true, as many numbers for all: those with fewer repeat one of theirs, or 0."""
    rows = [np.flatnonzero(row) for row in mask]
    most = max(map(len, rows))
    return np.stack([np.pad(r, (0, most - len(r)), mode="edge" if len(r) else "constant") for r in rows])


def _learn(
    config: TrainConfig,
    state: _State,
    rollout: Rollout,
    obs: Float[np.ndarray, "seed sample obs"],
    advantages: Float[np.ndarray, "time seed env"],
    keys: Key[Array, " seed"],
) -> tuple[GaussianPolicy, optax.OptState | None, UpdateInfo]:
    """The algorithm's update of all policies."""
    learner = config.learns
    if config.algo == "trpo":
        scaled = jnp.asarray(_per_seed(advantages), dtype=jnp.float32)
        actions = jnp.asarray(_per_seed(rollout.actions))
        policies, info = _update_trpo(state.policies, jnp.asarray(obs), actions, scaled, learner.trpo)
        return policies, state.adam, info
    actions, weights = rollout.actions, advantages.astype(np.float32)
    if learner.ppo.of_steps:
        parts = obs, _per_seed(actions), _per_seed(weights)
    else:
        num_seeds, num_steps = obs.shape[0], len(rollout.rewards)
        by_time = obs.reshape(num_seeds, num_steps, -1, obs.shape[-1])
        trajectories = np.ascontiguousarray(by_time.transpose(0, 2, 1, 3))
        parts = trajectories, np.moveaxis(actions, 0, 2), np.moveaxis(weights, 0, 2)
    sampled, taken, worth = map(jnp.asarray, parts)
    return _update_ppo(state.policies, state.adam, sampled, taken, worth, keys, learner.ppo)


@eqx.filter_jit
def _update_trpo(
    policies: GaussianPolicy,
    obs: Float[Array, "seed sample obs"],
    actions: Float[Array, "seed sample action"],
    advantages: Float[Array, "seed sample"],
    config: TRPOConfig,
) -> tuple[GaussianPolicy, UpdateInfo]:
    return eqx.filter_vmap(lambda p, o, a, adv: trpo.update(p, o, a, adv, config))(
        policies, obs, actions, advantages
    )


@eqx.filter_jit
def _update_ppo(
    policies: GaussianPolicy,
    adam: optax.OptState | None,
    obs: Float[Array, "seed sample *time obs"],
    actions: Float[Array, "seed sample *time action"],
    advantages: Float[Array, "seed sample *time"],
    keys: Key[Array, " seed"],
    config: PPOConfig,
) -> tuple[GaussianPolicy, optax.OptState, UpdateInfo]:
    def one(policy: GaussianPolicy, adam: optax.OptState, o: Array, a: Array, adv: Array, key: Any):
        log_prob = policy.log_prob(o, a)
        return ppo.update(policy, adam, ppo.Batch(o, a, adv, log_prob), config, key=key)

    return eqx.filter_vmap(one)(policies, adam, obs, actions, advantages, keys)


def _keys(config: TrainConfig, use: int) -> Key[Array, " seed"]:
    """A key for each seed: 0 to draw its networks, 1 + i for iteration i."""
    keys = [jr.key(seed) for seed in config.seeds]
    return jnp.stack([jr.fold_in(key, use) if use else key for key in keys])


def _init(config: TrainConfig, observer: Observer, batch: TaskBatch) -> _State:
    learner = config.learns
    obs = observer(batch.states[:1], batch.targets[:1])
    num_policy, num_critic = (obs[:, c].shape[1] for c in (observer.policy_columns, observer.critic_columns))
    num_actions = len(batch.simulator.control_low)
    keys = _keys(config, 0)

    def init_one(key: Key[Array, ""]) -> GaussianPolicy:
        return GaussianPolicy(
            num_policy, num_actions, hidden=learner.hidden, layer_norm=learner.layer_norm, key=key
        )

    policies = eqx.filter_vmap(init_one)(keys)
    adam = eqx.filter_vmap(ppo.optimiser(learner.ppo).init)(policies) if config.algo == "ppo" else None
    shape = (config.iterations, config.num_seeds)
    return _State(
        policies=policies,
        adam=adam,
        critic=make_critic(learner.critic, num_critic, jax.vmap(lambda k: jr.fold_in(k, 0))(keys)),
        statistics=ObsStatistics.empty(config.num_seeds, obs.shape[1]),
        history={key: np.full(shape, np.nan) for key in HISTORY_KEYS},
    )


def _save_policies(
    config: TrainConfig, observer: Observer, batch: TaskBatch, state: _State, out: Path
) -> None:
    """Leaves the policies, and what makes z, where `load_policy` finds them."""
    if config.z != "none" and observer.embedding is not None and not (out / EMBEDDING).exists():
        observer.embedding.save(out / EMBEDDING)
    mean, columns = state.policies.mean, observer.policy_columns
    arrays = {f"{n}.weight": np.asarray(w) for n, w in enumerate(mean.weights)}
    arrays |= {f"{n}.bias": np.asarray(b) for n, b in enumerate(mean.biases)}
    arrays["log_std"] = np.asarray(state.policies.log_std)
    if config.learns.normalise_obs:
        arrays |= state.statistics._asdict()
    low, high = batch.simulator.control_low, batch.simulator.control_high
    about = {
        "task": config.task,
        "env_id": observer.task.env_id,
        "obs": config.obs,
        "z": config.z,
        "z_to": config.z_to,
        "num_obs": observer(batch.states[:1], batch.targets[:1]).shape[1],
        "columns": [columns.start, columns.stop],
        "layer_norm": mean.layer_norm,
        "action_low": low.tolist(),
        "action_high": high.tolist(),
        "seeds": list(config.seeds),
        "returns": state.history["return"][-LAST:].mean(axis=0).tolist(),
        "versions": {"planspace": planspace.__version__},
    }
    save_policies(out, arrays, about)


def _record(
    history: dict[str, Any],
    iteration: int,
    rollout: Rollout,
    info: UpdateInfo,
    returns: Float[np.ndarray, "seed sample"],
    value: Float[np.ndarray, "seed sample"],
) -> dict[str, Any]:
    episode_return, length = episode_returns(rollout)
    unexplained = np.var(returns - value, axis=1) / np.maximum(np.var(returns, axis=1), 1e-12)
    row = {
        "return": episode_return,
        "length": length,
        "kl": info.kl,
        "entropy": info.entropy,
        "loss": info.loss,
        "improvement": info.improvement,
        "explained_variance": 1.0 - unexplained,
        "skipped": info.skipped,
    }
    updated = {key: np.array(values) for key, values in history.items()}
    for key in HISTORY_KEYS:
        updated[key][iteration] = np.asarray(row[key], dtype=float)
    return updated


def _log(out: Path, state: _State, first: int, last: int) -> None:
    for i in range(first, last):
        row = {key: state.history[key][i].tolist() for key in HISTORY_KEYS}
        append_row(out / "log.jsonl", {"iteration": i + 1, "time": time.time(), **row})


def _per_seed(x: Shaped[np.ndarray, "time seed env *rest"]) -> Shaped[np.ndarray, "seed sample *rest"]:
    """Brings the seed to the front and lays time and environments end to end."""
    moved = np.moveaxis(x, 1, 0)
    return moved.reshape(moved.shape[0], -1, *moved.shape[3:])
