"""Training: one arm (task, algorithm, observation), all its seeds in one program."""

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import mujoco
import numpy as np
from jaxtyping import Array, Float, Key

import planspace
from planspace.checkpoint import load_checkpoint, save_checkpoint
from planspace.embed.embedding import Embedding
from planspace.envs.batch import TaskBatch
from planspace.errors import UsageError
from planspace.progress import progress
from planspace.rl import critic
from planspace.rl.advantage import discounted_returns, gae
from planspace.rl.observe import Observer, ZMode, ZTarget
from planspace.rl.policy import Actor, GaussianPolicy
from planspace.rl.rollout import Rollout, collect, episode_returns
from planspace.rl.trpo import TRPOConfig, UpdateInfo, update
from planspace.store import Arrays, append_row, open_run, read_arrays, write_arrays
from planspace.tasks import ObsForm, find_task

BATCH_STEPS = 4000
"""Steps an iteration and seed (the 2020 runs: 20 episodes of 200, or 40 of 100)."""
CHECKPOINT_EVERY = 10
"""Iterations between checkpoints."""
HISTORY = "history.safetensors"

HISTORY_KEYS = ("return", "length", "kl", "entropy", "improvement", "explained_variance", "skipped")
"""What is recorded for each iteration and seed; see `UpdateInfo` and `episode_returns`."""


@dataclass(frozen=True)
class TrainConfig:
    """One arm."""

    task: str
    """The task's name."""
    algo: Literal["trpo"] = "trpo"
    """The algorithm."""
    obs: ObsForm = "raw"
    """`raw`, or `trig`: raw with sin and cos of its angles."""
    z: ZMode = "none"
    """`none`, `augment`: the observation with z appended, `replace`: z alone."""
    z_to: ZTarget = "both"
    """Who sees z."""
    num_seeds: int = 5
    """How many seeds."""
    seed: int = 0
    """The first of them."""
    steps: int = 960_000
    """Environment steps a seed; rounded up to whole iterations."""
    trpo: TRPOConfig = field(default_factory=TRPOConfig)
    """The algorithm's settings."""

    def __post_init__(self) -> None:
        """Checks the sizes.

        Raises:
            UsageError: fewer than one seed or step.
        """
        if self.num_seeds < 1 or self.steps < 1:
            raise UsageError(f"seeds and steps must be at least 1, got {self.num_seeds} and {self.steps}.")

    @property
    def iterations(self) -> int:
        """Iterations of `BATCH_STEPS` that make at least `steps`."""
        return -(-self.steps // BATCH_STEPS)


class _State(eqx.Module):
    """Everything that changes from one iteration to the next, with a leading axis of seeds.

    Every iteration starts from fresh episodes and from streams made of seed and iteration, so neither
    physics nor random states belong here.
    """

    policies: GaussianPolicy
    critic_weights: Float[Any, "seed feature"]
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
    seeds = range(config.seed, config.seed + config.num_seeds)
    rngs = [np.random.default_rng(np.random.SeedSequence([seed, iteration])) for seed in seeds]
    num_steps = BATCH_STEPS * config.num_seeds // len(batch.states)
    rollout = collect(batch, observer, Actor(state.policies), num_steps, rngs)
    value, next_value, x = _values(rollout, observer, np.asarray(state.critic_weights))
    truncated = rollout.timeout | rollout.cut
    # no bootstrap at the time limit, as in the 2020 runs; a record cut mid-episode is bootstrapped
    next_value = np.where(rollout.timeout, 0.0, next_value)
    discount = config.trpo.discount
    advantages = _per_seed(
        gae(
            rollout.rewards,
            value,
            next_value,
            rollout.terminated,
            truncated,
            discount=discount,
            trace=config.trpo.gae_lambda,
        )
    )
    mean, deviation = advantages.mean(axis=1, keepdims=True), advantages.std(axis=1, keepdims=True)
    advantages = (advantages - mean) / (deviation + 1e-8)
    policies, info = _update(
        state.policies,
        jnp.asarray(_per_seed(rollout.obs[..., observer.policy_columns])),
        jnp.asarray(_per_seed(rollout.actions)),
        jnp.asarray(advantages, dtype=jnp.float32),
        config.trpo,
    )
    returns = _per_seed(
        discounted_returns(rollout.rewards, next_value, rollout.terminated, truncated, discount=discount)
    )
    history = _record(state.history, iteration, rollout, info, returns, _per_seed(value))
    return _State(policies, critic.fit(_per_seed(x), returns), history)


def _values(
    rollout: Rollout, observer: Observer, weights: Float[np.ndarray, "seed feature"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The critic's value before and after each step [time, seed, env], and its features before it."""
    x = critic.features(rollout.obs[..., observer.critic_columns], rollout.step)
    value = _predict(x, weights)
    next_value = np.zeros_like(value)
    next_value[:-1] = value[1:]
    cut = rollout.cut  # elsewhere the next state is the next row's, or its value is not used
    if cut.any():
        after = critic.features(rollout.next_obs[cut][:, observer.critic_columns], rollout.step[cut] + 1)
        seed_of = np.broadcast_to(np.arange(cut.shape[1])[None, :, None], cut.shape)[cut]
        next_value[cut] = np.einsum("nf,nf->n", after, weights[seed_of])
    return value, next_value, x


def _predict(x: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.einsum("tsef,sf->tse", x, weights, optimize=True)


@eqx.filter_jit
def _update(
    policies: GaussianPolicy,
    obs: Float[Array, "seed sample obs"],
    actions: Float[Array, "seed sample action"],
    advantages: Float[Array, "seed sample"],
    config: TRPOConfig,
) -> tuple[GaussianPolicy, UpdateInfo]:
    return eqx.filter_vmap(lambda p, o, a, adv: update(p, o, a, adv, config))(
        policies, obs, actions, advantages
    )


def _init(config: TrainConfig, observer: Observer, batch: TaskBatch) -> _State:
    obs = observer(batch.states[:1], batch.targets[:1])
    num_policy = obs[:, observer.policy_columns].shape[1]
    num_features = critic.features(obs[:, observer.critic_columns], np.zeros(1, int)).shape[1]
    num_actions = len(batch.simulator.control_low)
    keys = jnp.stack([jr.key(s) for s in range(config.seed, config.seed + config.num_seeds)])

    def init_one(key: Key[Array, ""]) -> GaussianPolicy:
        return GaussianPolicy(num_policy, num_actions, key=key)

    shape = (config.iterations, config.num_seeds)
    return _State(
        policies=eqx.filter_vmap(init_one)(keys),
        critic_weights=np.zeros((config.num_seeds, num_features)),
        history={key: np.full(shape, np.nan) for key in HISTORY_KEYS},
    )


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


def _per_seed(x: Float[np.ndarray, "time seed env *rest"]) -> Float[np.ndarray, "seed sample *rest"]:
    """Brings the seed to the front and lays time and environments end to end."""
    moved = np.moveaxis(x, 1, 0)
    return moved.reshape(moved.shape[0], -1, *moved.shape[3:])
