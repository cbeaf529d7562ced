"""A replay buffer for hindsight experience replay in Stable-Baselines3 that knows z (extra `sb3`)."""

from typing import Any

from planspace.envs.observation_view import GoalView
from planspace.errors import PlanspaceError, install_command

try:
    from stable_baselines3 import HerReplayBuffer
except ImportError as error:
    raise PlanspaceError(
        f"Stable-Baselines3 is not installed: {install_command('sb3')}. On a machine without a GPU, "
        "install the CPU build of torch first."
    ) from error


class PlanSpaceHerReplayBuffer(HerReplayBuffer):
    """`HerReplayBuffer` for environments with `PlanSpaceObservation` or `PlanSpaceShaping`.

    SB3 replaces `desired_goal` when it relabels a step, and computes its reward. This buffer also computes
    `z_desired_goal` and `z_difference` for the new goal, and keeps the infos that shaping needs.
    """

    def __init__(self, *args: Any, copy_info_dict: bool = True, **kwargs: Any):
        """Make a buffer; SB3 calls this with the arguments of `HerReplayBuffer`."""
        super().__init__(*args, copy_info_dict=copy_info_dict, **kwargs)
        self._views: list[GoalView] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what is saved; what the environment provides is not."""
        return super().__getstate__() | {"_views": None}

    def _normalize_obs(self, obs: Any, env: Any = None) -> Any:  # pyright: ignore  SB3 calls it on self
        """Compute z of the goals, then normalise as SB3 does; it calls this with relabelled observations."""
        for view in self._goal_views():
            obs = {**obs, **view(obs)}
        return super()._normalize_obs(obs, env)

    def _goal_views(self) -> list[GoalView]:
        if self._views is None and self.env is not None:
            asked = self.env.has_attr("recompute_goals")
            self._views = self.env.env_method("recompute_goals", indices=[0])[0] if asked else []
        return self._views or []
