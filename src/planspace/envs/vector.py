"""Many environments of a task as one Gymnasium vector environment, in one batch of simulations."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool

from planspace.envs.batch import TaskBatch
from planspace.envs.pixels import PixelStacks, find_view
from planspace.envs.render import Renderer
from planspace.envs.task import (
    Described,
    checked_actions,
    checked_options,
    find_render_mode,
    frames_per_second,
    given_states,
    spaces_of,
)
from planspace.errors import UsageError, check_whole, unknown
from planspace.physics.pictures import PictureConfig
from planspace.tasks.catalog import find_task
from planspace.tasks.task import Task, find_reward_type

MODES = tuple(mode.value for mode in AutoresetMode)


class TaskVectorEnv(Described, VectorEnv[np.ndarray, np.ndarray, np.ndarray], gymnasium.utils.EzPickle):
    """A vector environment that gives what `SyncVectorEnv` with `TaskEnv` gives, bit for bit, but faster.

    `planspace.make_env("cartpole-swingup", 64)` makes one. Each environment has its own random stream, so
    that its episodes do not depend on the other environments.
    """

    metadata = {  # noqa: RUF012  as Gymnasium does
        "render_modes": ["rgb_array"],
        "render_fps": 25,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(  # noqa: PLR0913  Gymnasium passes them one by one
        self,
        task: str | Path | Task,
        num_envs: int = 1,
        obs: str = "raw",
        reward: str = "dense",
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        render_mode: str | None = None,
        pictures: PictureConfig | None = None,
    ):
        """Make the environment; `gymnasium.make_vec` and `planspace.make_env` call this.

        Args:
            task: the task's name, or a task of your own.
            num_envs: number of environments.
            obs: observation type, as for `TaskEnv`.
            reward: reward type, as for `TaskEnv`.
            max_episode_steps: steps before an episode is truncated; None uses the task's horizon, and -1
                never truncates, as in Gymnasium.
            autoreset_mode: `NextStep`, `SameStep` or `Disabled`, as in Gymnasium.
            threads: physics threads; 0 uses all CPUs. Results do not depend on it.
            render_mode: `rgb_array` or None.
            pictures: as for `TaskEnv`.

        Raises:
            UsageError: an argument has another value, or a task does not fit its model.
        """
        gymnasium.utils.EzPickle.__init__(
            self,
            task,
            num_envs,
            obs,
            reward,
            max_episode_steps,
            autoreset_mode,
            threads,
            render_mode,
            pictures,
        )
        self.task = find_task(task)
        check_whole("num_envs", num_envs)
        self.num_envs = num_envs
        self.obs, view = find_view(obs, pictures)
        self.render_mode = find_render_mode(render_mode, self.metadata["render_modes"])
        self.autoreset_mode = _find_autoreset_mode(autoreset_mode)
        self.max_episode_steps = _step_limit(self.task, max_episode_steps)
        self._batch = TaskBatch(
            self.task, num_envs, threads=threads, reward=find_reward_type(reward, self.task)
        )
        self.metadata = {
            **self.metadata,
            "autoreset_mode": self.autoreset_mode,
            "render_fps": frames_per_second(self._batch),
        }
        self._pixels = None if view is None else PixelStacks(self._batch, view)
        self.single_observation_space, self.single_action_space = spaces_of(
            self.task, self.obs, self._batch, view
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs = [seeding.np_random()[0] for _ in range(num_envs)]
        self._elapsed = np.zeros(num_envs, dtype=int)
        self._ended = np.zeros(num_envs, dtype=bool)
        self._started = False
        self._renderer = Renderer(self._batch)

    @property
    def states(self) -> np.ndarray:
        """The current planning states [env, state]."""
        return self._batch.states.copy()

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start all episodes, or those in a mask.

        Args:
            seed: the seeds of the random streams: a number s means s, s + 1, ...; a list has one for each, or
                None to continue a stream.
            options: `{"state": ...}` starts from a given planning state, one for all or one for each;
                `{"reset_mask": ...}` chooses the environments that start; the others continue.

        Raises:
            UsageError: seeds, states or mask have the wrong shape, or the name of an option is misspelt.
        """
        options = checked_options(options, "state", "reset_mask")
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + i for i in range(self.num_envs)]
        if seed is not None and len(seed) != self.num_envs:
            raise UsageError(f"expected {self.num_envs} seeds, one for each environment, got {len(seed)}.")
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise UsageError(f"reset_mask must have {self.num_envs} truth values, at least one of them true.")
        for i in np.flatnonzero(mask):
            if seed is not None and seed[i] is not None:
                self._rngs[i] = seeding.np_random(seed[i])[0]
        self._begin(mask, options.get("state"))
        self._started = True
        info: dict[str, Any] = {}
        self._record_info(info, mask, np.zeros(self.num_envs, dtype=bool))
        return self._observe(), info

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one step in every environment; episodes that ended restart according to the autoreset mode.

        If the physics of an episode diverge, it is truncated and its `info["diverged"]` is true.

        Raises:
            UsageError: the actions have the wrong shape or are not finite, or an ended episode was not reset.
            gymnasium.error.ResetNeeded: `reset` was not called before.
        """
        if not self._started:
            raise gymnasium.error.ResetNeeded("Cannot call env.step() before calling env.reset()")
        actions = checked_actions(actions, self.action_space)
        restarting = self._ended
        if self.autoreset_mode == AutoresetMode.DISABLED and restarting.any():
            raise UsageError(
                f"episodes {np.flatnonzero(restarting).tolist()} have ended: reset them first, with "
                'options={"reset_mask": ...}.'
            )
        rewards, terminated, diverged = self._batch.step(actions)
        self._elapsed += 1
        truncated = diverged | (self._elapsed >= self.max_episode_steps)
        if self._pixels is not None:
            self._pixels.push(np.flatnonzero(~restarting))
        if restarting.any():  # in these environments this step is the reset
            rewards[restarting] = 0.0
            terminated, truncated = terminated & ~restarting, truncated & ~restarting
            diverged = diverged & ~restarting
            self._begin(restarting)
        self._ended = terminated | truncated
        info: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._ended.any():
            self._finish(info, self._ended, diverged)
            diverged = diverged & ~self._ended
            self._begin(self._ended)
        self._record_info(info, np.ones(self.num_envs, dtype=bool), diverged)
        return self._observe(), rewards, terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return an image [height, width, 3] of each environment if the render mode is `rgb_array`."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(self._renderer.picture(i) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Free the graphics library."""
        if hasattr(self, "_renderer"):  # Gymnasium before 1.3 also closes environments that failed to start
            self._renderer.close()
            if self._pixels is not None:
                self._pixels.close()

    def _observe(self) -> np.ndarray:
        if self._pixels is not None:
            return self._pixels.stacks()
        return self.task.observe_as(self.obs, self._batch.states, self._batch.targets).astype(np.float32)

    def _begin(self, mask: Bool[np.ndarray, " env"], given: Any = None) -> None:
        """Start the episodes in the mask from drawn states, or from given ones."""
        ids = np.flatnonzero(mask)
        starts = [self.task.sample_starts(1, self._rngs[i]) for i in ids]
        states, targets = (np.concatenate(part) for part in zip(*starts, strict=True))
        if given is not None:
            states = given_states(given, self._batch.simulator.space, self.num_envs)[ids]
        self._batch.reset(states, targets, ids.astype(np.int32))
        if self._pixels is not None:
            self._pixels.restart(ids, [self._rngs[i] for i in ids])
        self._elapsed[ids], self._ended[ids] = 0, False

    def _finish(self, info: dict[str, Any], ended: np.ndarray, diverged: np.ndarray) -> None:
        """Record how the ended episodes ended, before they restart."""
        last = np.full(self.num_envs, None, dtype=object)
        obs = self._observe()
        for i in np.flatnonzero(ended):
            last[i] = obs[i]
        final: dict[str, Any] = {}
        self._record_info(final, ended, diverged)
        info |= {"final_obs": last, "_final_obs": ended.copy()}
        info |= {"final_info": final, "_final_info": ended.copy()}

    def _record_info(self, info: dict[str, Any], mask: np.ndarray, diverged: np.ndarray) -> None:
        """Record the state of the episodes in the mask, and 0 for the others, as Gymnasium does."""
        info |= {"state": np.where(mask[:, None], self._batch.states, 0.0), "_state": mask.copy()}
        info |= {"diverged": diverged & mask, "_diverged": mask.copy()}


def _find_autoreset_mode(mode: str | AutoresetMode) -> AutoresetMode:
    name = mode.value if isinstance(mode, AutoresetMode) else mode
    if name not in MODES:
        raise unknown("autoreset mode", name, MODES)
    return AutoresetMode(name)


def _step_limit(task: Task, steps: int | None) -> int:
    """The length at which episodes are truncated."""
    limit = task.horizon if steps is None else steps
    if limit == -1:
        return np.iinfo(int).max
    if limit < 1:
        raise UsageError(f"max_episode_steps must be 1 or more, or -1 for no limit, got {limit}.")
    return limit
