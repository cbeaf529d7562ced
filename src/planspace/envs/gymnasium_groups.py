"""Gymnasium environments that are stepped together, in this process or in worker processes.

`gymnasium.vector.AsyncVectorEnv` would start one process for each environment, fork a process in which JAX
runs, and start the next episodes by itself. Here a worker steps several environments one after another.
"""

import importlib
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, NamedTuple, Protocol

import gymnasium
import numpy as np
from jaxtyping import Bool, Float, Int

from planspace.envs.gymnasium_env import GymTaskEnv
from planspace.errors import PlanspaceError
from planspace.tasks.gymnasium import GymTask
from planspace.workers import WorkerDied, WorkerPool


class GymSteps(NamedTuple):
    """The result of one step in several environments."""

    states: Float[np.ndarray, "env state"]
    rewards: Float[np.ndarray, " env"]
    terminated: Bool[np.ndarray, " env"]
    truncated: Bool[np.ndarray, " env"]


class Group(Protocol):
    """Environments that are stepped together."""

    def reset(
        self, ids: Int[np.ndarray, " env"], seeds: Int[np.ndarray, " env"]
    ) -> Float[np.ndarray, "env state"]:
        """Start an episode in some environments, each with its seed, and return their states."""
        ...

    def set_states(
        self, ids: Int[np.ndarray, " env"], values: Float[np.ndarray, "env settable"]
    ) -> Float[np.ndarray, "env state"]:
        """Put some environments, whose episodes have just started, into other states.

        Args:
            ids: the environments.
            values: the numbers `task.sizes.settable_names` of each.

        Returns:
            Their states, all numbers.
        """
        ...

    def step(self, ids: Int[np.ndarray, " env"], actions: Float[np.ndarray, "env action"]) -> GymSteps:
        """Take one step in some environments."""
        ...

    def close(self) -> None:
        """Close the environments."""
        ...


class LocalGroup:
    """Environments that this process steps one after another."""

    def __init__(self, task: GymTask, num: int):
        """Make `num` environments of a task."""
        self._envs = [GymTaskEnv(task) for _ in range(num)]
        self._width = len(task.state_names)

    def reset(
        self, ids: Int[np.ndarray, " env"], seeds: Int[np.ndarray, " env"]
    ) -> Float[np.ndarray, "env state"]:
        """Start an episode in some environments, each with its seed, and return their states."""
        states = np.zeros((len(ids), self._width))
        for row, (i, seed) in enumerate(zip(ids, seeds, strict=True)):
            self._envs[i].reset(seed=int(seed))
            states[row] = self._envs[i].state
        return states

    def set_states(
        self, ids: Int[np.ndarray, " env"], values: Float[np.ndarray, "env settable"]
    ) -> Float[np.ndarray, "env state"]:
        """Put some environments, whose episodes have just started, into other states."""
        states = np.zeros((len(ids), self._width))
        for row, i in enumerate(ids):
            self._envs[i].set_state(values[row])
            states[row] = self._envs[i].state
        return states

    def step(self, ids: Int[np.ndarray, " env"], actions: Float[np.ndarray, "env action"]) -> GymSteps:
        """Take one step in some environments."""
        states, rewards = np.zeros((len(ids), self._width)), np.zeros(len(ids))
        terminated, truncated = np.zeros((2, len(ids)), bool)
        for row, i in enumerate(ids):
            _, rewards[row], terminated[row], truncated[row], _ = self._envs[i].step(actions[row])
            states[row] = self._envs[i].state
        return GymSteps(states, rewards, terminated, truncated)

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs:
            env.close()


class WorkerGroup:
    """Environments that worker processes step at the same time, each worker its own ones.

    An environment does the same as in a `LocalGroup`, bit for bit.
    """

    def __init__(self, task: GymTask, num: int, workers: int):
        """Make the environments.

        Args:
            task: the task.
            num: number of environments.
            workers: number of processes; at most one for each environment is started.

        Raises:
            PlanspaceError: an environment cannot be made in a worker.
        """
        self._width, self._workers = len(task.state_names), min(workers, num)
        self._pools = [WorkerPool(1) for _ in range(self._workers)]
        sizes = [len(range(w, num, self._workers)) for w in range(self._workers)]
        spec = gymnasium.spec(task.registered_id)
        try:
            self._results([(w, _make, (task, spec, size)) for w, size in enumerate(sizes)])
        except BaseException:
            self.close()
            raise

    def reset(
        self, ids: Int[np.ndarray, " env"], seeds: Int[np.ndarray, " env"]
    ) -> Float[np.ndarray, "env state"]:
        """Start an episode in some environments, each with its seed, and return their states."""
        return self._states(_reset, ids, seeds)

    def set_states(
        self, ids: Int[np.ndarray, " env"], values: Float[np.ndarray, "env settable"]
    ) -> Float[np.ndarray, "env state"]:
        """Put some environments, whose episodes have just started, into other states."""
        return self._states(_set_states, ids, values)

    def step(self, ids: Int[np.ndarray, " env"], actions: Float[np.ndarray, "env action"]) -> GymSteps:
        """Take one step in some environments."""
        rows = self._rows(ids)
        calls = [(w, _step, (ids[at] // self._workers, actions[at])) for w, at in rows.items()]
        steps = GymSteps(
            np.zeros((len(ids), self._width)), np.zeros(len(ids)), *np.zeros((2, len(ids)), bool)
        )
        for at, part in zip(rows.values(), self._results(calls), strict=True):
            for whole, numbers in zip(steps, part, strict=True):
                whole[at] = numbers
        return steps

    def close(self) -> None:
        """End the worker processes, and with them the environments."""
        for pool in self._pools:
            pool.close()

    def _states(
        self, function: Callable[..., np.ndarray], ids: Int[np.ndarray, " env"], values: np.ndarray
    ) -> Float[np.ndarray, "env state"]:
        """Call a function in the workers with their environments and the values of these."""
        states = np.zeros((len(ids), self._width))
        rows = self._rows(ids)
        calls = [(w, function, (ids[at] // self._workers, values[at])) for w, at in rows.items()]
        for at, part in zip(rows.values(), self._results(calls), strict=True):
            states[at] = part
        return states

    def _rows(self, ids: Int[np.ndarray, " env"]) -> dict[int, Int[np.ndarray, " row"]]:
        """The rows of `ids` that each worker steps: environment i belongs to worker i modulo their number."""
        owner = ids % self._workers
        return {int(w): np.flatnonzero(owner == w) for w in np.unique(owner)}

    def _results(self, calls: Sequence[tuple[int, Any, tuple[Any, ...]]]) -> list[Any]:
        """Call functions in workers at the same time, and return the results in order."""
        futures: list[Future] = [self._pools[w].submit(function, *args) for w, function, args in calls]
        try:
            return [future.result() for future in futures]
        except WorkerDied as error:
            raise PlanspaceError(
                f"a worker process that steps environments ended unexpectedly ({error}); `--env-workers 0` "
                "steps them in this process."
            ) from error


_groups: list[LocalGroup] = []
"""The environments of this worker process."""


def _make(task: GymTask, spec: Any, num: int) -> None:
    """Make this worker's environments; the worker may not know an id that the caller's script registered."""
    if isinstance(spec.entry_point, str):
        importlib.import_module(spec.entry_point.partition(":")[0])  # may register the id itself
    gymnasium.registry.setdefault(spec.id, spec)
    _groups[:] = [LocalGroup(task, num)]


def _reset(ids: Int[np.ndarray, " env"], seeds: Int[np.ndarray, " env"]) -> np.ndarray:
    return _groups[0].reset(ids, seeds)


def _set_states(ids: Int[np.ndarray, " env"], values: np.ndarray) -> np.ndarray:
    return _groups[0].set_states(ids, values)


def _step(ids: Int[np.ndarray, " env"], actions: np.ndarray) -> GymSteps:
    return _groups[0].step(ids, actions)
