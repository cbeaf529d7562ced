"""Checks of an algorithm's results, so that an invalid one is refused where the algorithm returns it."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from planspace.errors import UsageError, check_setting, quoted
from planspace.rl.algorithm import HOW_TO
from planspace.rl.arm import Arm
from planspace.rl.config import TrainConfig
from planspace.rl.policy_network import PolicyNetwork
from planspace.rl.rollout import Rollout
from planspace.seams import name_of
from planspace.tasks.gymnasium import AnyTask, GymTask


def check_uses_of_plans(config: TrainConfig) -> None:
    """Check that the algorithm can use transitions along plans, if it is to.

    Raises:
        UsageError: `replay` is above 0, but the algorithm does not have the class attribute `replays = True`;
            or `clone` or `clone_weight` is, but it does not have `clones = True`.
    """
    for name in ("clone", "clone_weight"):
        if getattr(config, name) and not getattr(config.algorithm, "clones", False):
            raise UsageError(
                f"--{name.replace('_', '-')} {getattr(config, name):g} needs an algorithm that can imitate "
                f"plans, but {name_of(config.algorithm)} cannot: leave it out, or use --resets. An algorithm "
                f"of your own says `clones = True`; see {HOW_TO}."
            )
    if config.replay and not getattr(config.algorithm, "replays", False):
        raise UsageError(
            f"--replay {config.replay:g} needs an algorithm with a replay buffer, but "
            f"{name_of(config.algorithm)} has none: leave out --replay, or use --resets. An algorithm of "
            f"your own says `replays = True`; see {HOW_TO}."
        )


def check_env_workers(task: AnyTask, workers: int) -> None:
    """Check that the environments of a task can be stepped by this number of processes.

    Raises:
        UsageError: the number is not a whole number of at least 0, or the task is planspace's own.
    """
    check_setting("env_workers", workers, type(workers) is int and workers >= 0, "0 or more")
    if workers and not isinstance(task, GymTask):
        raise UsageError(
            f"--env-workers {workers} is for Gymnasium environments, but {task.name} is one batch of "
            "physics, which already uses every core: leave it out."
        )


def checked_state(state: Any, method: str = "init") -> Any:
    """The result of `Algorithm.init`, or of another method.

    Raises:
        UsageError: a number is not finite, or is not an array; checkpoints save arrays only.
    """
    for path, leaf in jax.tree.leaves_with_path(state):
        where = jax.tree_util.keystr(path)
        if isinstance(leaf, bool | int | float | complex | np.generic):
            raise _misfit(
                method, f"arrays only; np.array({leaf!r}) would do", f"{leaf!r} at {where or 'the top'}"
            )
        if hasattr(leaf, "dtype") and jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            raise _misfit(method, "no random keys; `update` gets one", f"a key at {where or 'the top'}")
    if not all_finite(state):
        raise _misfit(method, "finite numbers", "NaN or infinity")
    return state


def checked_rollout(rollout: Any, arm: Arm) -> Rollout:
    """The result of `Algorithm.collect`.

    Raises:
        UsageError: it is not a rollout of all seeds.
    """
    if not isinstance(rollout, Rollout):
        raise _misfit("collect", "a Rollout, as `arm.rollout` does", f"{quoted(rollout)}")
    wanted, got = (arm.config.num_seeds, arm.num_envs), rollout.rewards.shape[1:]
    if got != wanted:
        raise _misfit("collect", f"rewards of shape [time, seed, env] with (seed, env) = {wanted}", f"{got}")
    return rollout


def checked_update(result: Any, before: Any, method: str = "update") -> tuple[Any, dict[str, float]]:
    """The result of `Algorithm.update`, or of another method that returns a state.

    Raises:
        UsageError: it is not a pair of a state with the structure of the one before and numbers by name.
    """
    if not isinstance(result, tuple) or len(result) != 2 or not isinstance(result[1], Mapping):
        raise _misfit("update", "a state and a mapping of numbers by name", quoted(result))
    state, numbers = result
    old, new = jax.tree.structure(before), jax.tree.structure(state)
    if old != new:
        raise _misfit(method, f"a state of the structure that `init` returned, {old}", f"{new}")
    leaves = zip(jax.tree.leaves_with_path(before), jax.tree.leaves(state), strict=True)
    for (path, a), b in leaves:
        if _kind(a) != _kind(b):
            where = jax.tree_util.keystr(path) or "its only array"
            raise _misfit(method, f"{where} with {_kind(a)}, as `init` did", _kind(b))
    for name, number in numbers.items():
        if not isinstance(name, str) or not name.isidentifier() or np.ndim(number) != 0:
            got = f"{quoted(number)} as {quoted(name)}"
            raise _misfit("update", "single numbers by names such as 'loss'", got)
    return state, {name: float(x) for name, x in numbers.items()}


def checked_network(network: Any, arm: Arm) -> PolicyNetwork:
    """The result of `Algorithm.act`.

    Raises:
        UsageError: it is not a network from observations to actions.
    """
    if not isinstance(network, PolicyNetwork):
        raise _misfit("act", "a PolicyNetwork", quoted(network))
    shapes = [np.shape(weight) for weight in network.weights]
    widths = [arm.num_policy_obs, *(np.shape(bias)[0] for bias in network.biases)]
    wanted = list(zip(widths[1:], widths[:-1], strict=True))
    if shapes != wanted or widths[-1] != arm.num_actions:
        sizes = f"{arm.num_policy_obs} observed numbers to {arm.num_actions} actions"
        raise _misfit(
            "act", f"weights [out, in] and biases [out] from {sizes}", f"weights of shapes {shapes}"
        )
    if network.limits is not None and not np.array_equal(network.limits, arm.episodes.action_limits):
        raise _misfit("act", "the limits `arm.episodes.action_limits`, or None", f"{network.limits}")
    return network


def checked_names(found: list[dict[str, float]], known: tuple[str, ...], reserved: tuple[str, ...]) -> None:
    """Check that every seed and iteration has the same numbers.

    Raises:
        UsageError: a name is missing, new, or taken by training.
    """
    for numbers in found:
        if taken := [name for name in numbers if name in reserved]:
            raise _misfit("update", "names that training does not use itself", taken[0])
        if set(numbers) != set(known):
            raise _misfit("update", f"the same numbers each time, {sorted(known)}", f"{sorted(numbers)}")


def all_finite(tree: Any) -> bool:
    """Whether every number of every array is finite."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(tree) if hasattr(leaf, "dtype")]
    return all(np.isfinite(x).all() for x in arrays if x.dtype.kind in "fc")


def _kind(leaf: Any) -> str:
    return f"shape {leaf.shape} and type {leaf.dtype}" if hasattr(leaf, "dtype") else type(leaf).__name__


def _misfit(method: str, wanted: str, got: str) -> UsageError:
    return UsageError(f"Algorithm.{method} must return {wanted}; got {got}. See {HOW_TO}.")
