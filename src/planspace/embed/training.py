"""Train all seeds of an embedding to the end, with progress, log and checkpoint between stretches."""

from collections.abc import Callable, Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from planspace.embed.config import FitConfig
from planspace.embed.losses import Terms
from planspace.embed.networks import PlanSpaceModel
from planspace.embed.objective import PAGE
from planspace.embed.samples import Samples
from planspace.embed.steps import init, make_advance
from planspace.errors import PlanspaceError, UsageError
from planspace.progress import progress
from planspace.storage.checkpoint import load_checkpoint, save_checkpoint

CHUNK = 100
"""Smallest number of steps that one compiled call takes."""
MAX_CHUNKS = 400
"""Largest number of calls in a training."""

Log = Callable[[int, int, PlanSpaceModel, dict[str, list[float]]], None]
"""Called after each stretch with: steps so far, steps before it, the models, and the mean terms per seed."""


def train(samples: Samples, config: FitConfig, seeds: Sequence[int], out: Path, log: Log) -> PlanSpaceModel:
    """Train, or continue from the checkpoint in `out`.

    Args:
        samples: the samples to draw from.
        config: how to train.
        seeds: each has its own random streams, which do not depend on the other seeds.
        out: the run's folder, for the checkpoint.
        log: receives the curves.

    Returns:
        The models, with a leading axis of seeds.

    Raises:
        PlanspaceError: a seed diverged; the checkpoint contains all seeds as they were before that step.
    """
    init_keys, keys = jnp.stack([jr.split(jr.key(s)) for s in seeds]).T
    saved = load_checkpoint(out, eqx.filter_eval_shape(init, init_keys, samples, config))
    if saved is None:
        state, first = init(init_keys, samples, config), 0
    else:
        state, first = saved[0], saved[1]["step"]
    chunk = max(CHUNK, -(-config.steps // MAX_CHUNKS))
    advance = make_advance(keys, samples, config, chunk)
    with progress("embed", config.steps, done=first, unit="step") as bar:
        if first < config.steps:
            bar.set_postfix_str("compiling")
        while first < config.steps:
            length = min(chunk, config.steps - first)
            after, terms = advance(state, first, length)
            bad = _first_bad(terms, advance(after, first + length, 1)[1], length)
            if bad is not None:
                step, seed_index = bad
                good = max(step - 1, 0)
                save_checkpoint(out, advance(state, first, good)[0], {"step": first + good})
                raise _divergence(first + step, first + good, seeds[seed_index], out)
            state = after
            first += length
            means = {name: np.asarray(v)[:, :length].mean(axis=1).tolist() for name, v in terms.items()}
            log(first, first - length, state.result, means)  # before the checkpoint, so that no row is lost
            save_checkpoint(out, state, {"step": first})
            bar.update(length)
            bar.set_postfix_str(f"bound {np.mean(means['bound']):.2f}", refresh=False)
    return state.result


def use_device(platform: str) -> None:
    """Make JAX compute on the first device of a platform from now on.

    Args:
        platform: cpu, gpu, cuda or tpu; any that the installed JAX knows.

    Raises:
        UsageError: there is no such device.
    """
    try:
        jax.config.update("jax_default_device", jax.devices(platform)[0])
    except RuntimeError as error:
        have = ", ".join(sorted({"cpu", jax.default_backend()}))
        raise UsageError(f"the installed JAX has no device {platform!r}; its devices are: {have}.") from error


def _first_bad(terms: Terms, next_terms: Terms, length: int) -> tuple[int, int] | None:
    """The first step of a stretch with a bound that is not finite, and its seed's index.

    The bound of a step is computed before its update. So the update before the first bad bound caused it, and
    the step after the stretch shows whether the last update was good.
    """
    bounds = np.concatenate([terms["bound"][:, :length], next_terms["bound"][:, :1]], axis=1)
    finite = np.isfinite(bounds)
    if finite.all():
        return None
    step = int(np.argmin(finite.all(axis=0)))
    return step, int(np.argmin(finite[:, step]))


def _divergence(bad: int, good: int, seed: int, out: Path) -> PlanspaceError:
    if bad == 0:
        return PlanspaceError(
            f"the loss of the Objective must be finite at the first step, but for seed {seed} it is not. "
            f"Look at the demonstrations (planspace demos show), or at the objective ({PAGE})."
        )
    return PlanspaceError(
        f"training diverged at step {bad} for seed {seed}; {out} contains all seeds as they were before, at "
        f"step {good}. Try a lower --learning-rate or other seeds, in another folder."
    )
