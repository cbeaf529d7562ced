"""Datasets that were recorded from one of planspace's own tasks, whose states need not be told."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import StateInfo
from planspace.demos.observations import flat
from planspace.errors import PlanspaceError, UsageError
from planspace.tasks.catalog import TASKS
from planspace.tasks.observation_types import OBSERVATION_TYPES, ObservationType
from planspace.tasks.task import Task

STATE_KEY = "state"
"""Where the tasks put the planning state in `info`."""
OURS = ("PlanSpaceObservation", "PlanSpaceShaping")
"""Wrappers that leave actions alone."""


@dataclass(frozen=True)
class RecordedTask:
    """What is known of a dataset by its task."""

    task: Task
    info: StateInfo
    step: float
    """Seconds between states."""
    obs_names: tuple[str, ...]
    """Names of the numbers of an observation; none where wrappers changed it."""
    notices: tuple[str, ...]
    """What may not be as it seems, one line each."""

    def states(
        self, wanted: StateInfo, observations: Any, infos: Any, where: str
    ) -> Float[np.ndarray, "time state"]:
        """The states of an episode that are wanted: from its infos, or out of its observations.

        Raises:
            UsageError: they are in neither.
        """
        own = self.info.names
        if missing := [name for name in wanted.names if name not in own]:
            raise UsageError(
                f"{where} was recorded from {self.task.env_id}, whose states are {', '.join(own)}; the "
                f"problem {wanted.problem!r} has {missing[0]!r} among its own."
            )
        if isinstance(infos, dict) and STATE_KEY in infos:
            numbers, names = flat(infos[STATE_KEY], f"the states of {where}"), own
        elif set(wanted.names) <= set(self.obs_names) and not isinstance(observations, dict):
            numbers, names = flat(observations, f"the observations of {where}"), self.obs_names
        else:
            names = ()
            numbers = np.empty((0, 0))
        if not names or numbers.shape[1] != len(names):
            raise UsageError(
                f"the observations of {where} do not hold the states ({', '.join(own)}); record with "
                "DataCollector(env, record_infos=True)."
            )
        return numbers[:, [names.index(name) for name in wanted.names]]


def recorded_task(metadata: Mapping[str, Any], dataset_id: str) -> RecordedTask | None:
    """The task that a dataset's metadata says it was recorded from, if it is one of ours.

    Raises:
        PlanspaceError: the metadata name a task of ours and contradict it.
    """
    spec = metadata.get("env_spec")
    try:
        spec = json.loads(spec) if isinstance(spec, str) else spec
    except (ValueError, RecursionError):
        return None
    if not isinstance(spec, dict):
        return None
    task = next((task for task in TASKS.values() if task.env_id == spec.get("id")), None)
    if task is None:
        return None
    settings, wrappers = spec.get("kwargs", {}), spec.get("additional_wrappers", [])
    obs = settings.get("obs", "raw") if isinstance(settings, dict) else None
    form: ObservationType | None = next((form for form in OBSERVATION_TYPES if form == obs), None)
    if form is None or not isinstance(wrappers, list) or not all(isinstance(w, dict) for w in wrappers):
        raise PlanspaceError(f"the environment's spec in the metadata of {dataset_id!r} is damaged.")
    model, space = task.compile()
    mjcf = task.mjcf
    foreign = [str(w.get("name")) for w in wrappers if w.get("name") not in OURS]
    notices = []
    if foreign:
        notices.append(
            f"recorded through {', '.join(foreign)}: its controls may not be those that were applied."
        )
    if settings.get("reward") == "2020":
        notices.append("recorded without limits on controls, which the model has: it may not replay.")
    return RecordedTask(
        task=task,
        info=StateInfo.of_model(model, space, problem=task.problem, joints=task.joints, mjcf=mjcf),
        step=float(task.frame_skip * model.opt.timestep),
        obs_names=() if wrappers else tuple(task.fields(form)),
        notices=tuple(notices),
    )
