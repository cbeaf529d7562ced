"""Minari datasets recorded from a planspace task, which determines the meaning of their states."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.formats.observations import flat
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from planspace.tasks.catalog import TASKS
from planspace.tasks.observation_types import OBSERVATION_TYPES, ObservationType
from planspace.tasks.task import Task

STATE_KEY = "state"
"""Key of the planning state in the `info` of a task."""
OURS = ("PlanSpaceObservation", "PlanSpaceShaping")
"""Wrappers that do not change actions."""


@dataclass(frozen=True)
class RecordedTask:
    """What the task says about a dataset."""

    task: Task
    """The task."""
    info: StateInfo
    """The meaning of the states."""
    step: float
    """Time between states [s]."""
    obs_names: tuple[str, ...]
    """Names of the numbers in an observation; empty if wrappers changed the observation."""
    notices: tuple[str, ...]
    """Warnings for the user, one line each."""

    def states(
        self, wanted: StateInfo, observations: Any, infos: Any, where: str
    ) -> Float[np.ndarray, "time state"]:
        """Extract the states of an episode from its infos or its observations.

        Args:
            wanted: the states to extract.
            observations: the observations of the episode.
            infos: the infos of the episode.
            where: the episode, for messages.

        Raises:
            UsageError: the states are in neither of them.
        """
        own = self.info.names
        if missing := [name for name in wanted.names if name not in own]:
            raise UsageError(
                f"{where} was recorded from {self.task.env_id}, whose states are {', '.join(own)}, but the "
                f"problem {wanted.problem!r} has a state {missing[0]!r}."
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
                f"the observations of {where} do not contain the states ({', '.join(own)}); record with "
                "DataCollector(env, record_infos=True)."
            )
        return numbers[:, [names.index(name) for name in wanted.names]]


def recorded_task(metadata: Mapping[str, Any], dataset_id: str) -> RecordedTask | None:
    """The planspace task that a dataset was recorded from, or None.

    Args:
        metadata: the metadata of the Minari dataset.
        dataset_id: its name, for messages.

    Raises:
        PlanspaceError: the metadata name a planspace task, but are damaged.
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
        raise PlanspaceError(f"the environment spec in the metadata of {dataset_id!r} is damaged.")
    model, space = task.compile()
    foreign = [str(w.get("name")) for w in wrappers if w.get("name") not in OURS]
    notices = []
    if foreign:
        notices.append(
            f"recorded through {', '.join(foreign)}: the applied controls may differ from the recorded ones."
        )
    if settings.get("reward") == "2020":
        notices.append(
            "recorded without control limits, but the model has limits: replaying may give other states."
        )
    return RecordedTask(
        task=task,
        info=StateInfo.of_model(
            model, space, problem=task.problem_name, joints=task.joints, source=task.source
        ),
        step=float(task.frame_skip * model.opt.timestep),
        obs_names=() if wrappers else tuple(task.fields(form)),
        notices=tuple(notices),
    )
