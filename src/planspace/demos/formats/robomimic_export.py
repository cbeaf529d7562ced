"""Export to robomimic's layout of HDF5 files, and what robomimic has no field for."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.formats.hdf5_file import find_array, hdf5_module, read_numbers, read_rows
from planspace.demos.state_info import StateInfo, parse_info
from planspace.errors import PlanspaceError
from planspace.storage.files import write_bytes

DATA, STATES, ACTIONS, OBSERVATIONS = "data", "states", "actions", "obs"
"""Names of groups and arrays."""
PREFIX = "planspace_"
"""Prefix of the attributes in which planspace keeps what robomimic has no field for."""
FIELDS = ("goal", "success", "index", "seed", "cost")
"""The fields of an episode that are kept there."""
INFO_KEY = "planspace"
"""Array of bytes with the meaning of the states as JSON, in files that planspace wrote."""


def write_robomimic(demos: Demos, target: str) -> Path:
    """Write demonstrations in robomimic's layout. `read_robomimic` reads them back with the same numbers.

    The last action of each demonstration is zero, rewards are 0, and the observation is `state`.

    Raises:
        PlanspaceError: h5py is not installed, or the file cannot be written.
    """
    h5py = hdf5_module()
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=("v108", "latest")) as opened:  # attributes of more than 64 kB
        description = json.dumps(demos.info.plain_with_files()).encode()
        opened.create_dataset(INFO_KEY, data=np.frombuffer(description, np.uint8), compression="gzip")
        data = opened.create_group(DATA)
        name = demos.info.problem or "planspace"
        data.attrs["env_args"] = json.dumps({"env_name": name, "type": 2, "env_kwargs": {}})
        data.attrs["total"] = len(demos.states)
        for i in range(len(demos)):
            _write_episode(data.create_group(f"demo_{i}"), demos.info, demos.episode(i))
    write_bytes(Path(target), buffer.getvalue())
    return Path(target)


def exported_info(opened: Any, path: Path) -> StateInfo | None:
    """Read the meaning of the states, if `write_robomimic` wrote the file.

    Args:
        opened: the `h5py.File`.
        path: its path, for messages.

    Raises:
        PlanspaceError: the description is damaged.
    """
    text = find_array(opened, INFO_KEY)
    if text is None:
        return None
    try:
        return parse_info(json.loads(read_rows(text).astype(np.uint8).tobytes()))
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise PlanspaceError(f"{path}: the description of the states by planspace is damaged.") from error


def exported_episode(
    group: Any,
    states: Float[np.ndarray, "time state"],
    controls: Float[np.ndarray, "step control"],
    times: Float[np.ndarray, " time"],
    where: str,
) -> Episode:
    """Build an episode that `write_robomimic` wrote.

    Args:
        group: its group.
        states: T + 1 states.
        controls: T controls.
        times: time of each state [s].
        where: its name, for messages.

    Raises:
        PlanspaceError: the attributes that robomimic has no field for are damaged.
    """
    found = [read_numbers(group, PREFIX + key) for key in FIELDS]
    goal, *numbers = [np.empty((0, 0)) if value is None else value for value in found]
    if goal.shape != states[0].shape or any(value.shape for value in numbers):
        raise PlanspaceError(f"{where}: the attributes written by planspace are damaged.")
    success, index, seed, cost = numbers
    return Episode(
        states, controls, times, goal.astype(float), bool(success), int(index), int(seed), float(cost)
    )


def _write_episode(group: Any, info: StateInfo, episode: Episode) -> None:
    num = len(episode.states)
    arrays = {
        STATES: np.column_stack([episode.times, episode.states]),
        ACTIONS: np.concatenate([episode.controls, np.zeros((1, info.num_controls))]),
        "rewards": np.zeros(num),
        "dones": np.arange(num) == num - 1,
        f"{OBSERVATIONS}/state": episode.states,
    }
    for key, array in arrays.items():
        group.create_dataset(key, data=array, compression="gzip" if array.size else None)
    group.attrs["num_samples"] = num
    if info.source is not None and info.source.is_text:
        group.attrs["model_file"] = info.source.text
    for key in FIELDS:
        group.attrs[PREFIX + key] = getattr(episode, key)
