"""Datasets that were recorded from one of planspace's own tasks, whose states need not be told."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import StateInfo
from planspace.demos.observations import flat
from planspace.errors import UsageError
from planspace.physics.simulate import ASSETS
from planspace.tasks import TASKS, Task, find_obs_form

STATE_KEY = "state"
"""Where the tasks put the planning state in `info`."""


@dataclass(frozen=True)
class RecordedTask:
    """What is known of a dataset by its task."""

    task: Task
    info: StateInfo
    step: float
    """Seconds between states."""
    obs_names: tuple[str, ...]
    """Names of the numbers of an observation, before whatever wrappers appended."""

    def states(self, observations: Any, infos: Any, where: str) -> Float[np.ndarray, "time state"]:
        """The states of an episode: from its infos, or out of its observations.

        Raises:
            UsageError: they are in neither.
        """
        if isinstance(infos, dict) and STATE_KEY in infos:
            return flat(infos[STATE_KEY], f"the states of {where}")
        if not set(self.info.names) <= set(self.obs_names) or isinstance(observations, dict):
            raise UsageError(
                f"the observations of {where} do not hold the states ({', '.join(self.info.names)}); record "
                "with DataCollector(env, record_infos=True)."
            )
        columns = [self.obs_names.index(name) for name in self.info.names]
        return flat(observations, f"the observations of {where}")[:, columns]


def recorded_task(metadata: dict[str, Any]) -> RecordedTask | None:
    """The task that a dataset's metadata says it was recorded from, if it is one of ours."""
    spec = metadata.get("env_spec")
    spec = json.loads(spec) if isinstance(spec, str) else spec
    if not isinstance(spec, dict):
        return None
    task = next((task for task in TASKS.values() if task.env_id == spec.get("id")), None)
    if task is None:
        return None
    model, space = task.compile()
    mjcf = (ASSETS / task.model).read_text()
    obs = spec.get("kwargs", {}).get("obs", "raw")
    return RecordedTask(
        task=task,
        info=StateInfo.of_model(model, space, problem=task.problem, joints=task.joints, mjcf=mjcf),
        step=float(task.frame_skip * model.opt.timestep),
        obs_names=tuple(task.fields(find_obs_form(obs))),
    )
