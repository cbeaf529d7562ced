"""D4RL's layout of HDF5 files: all episodes laid end to end.

observations [N, n], actions [N, m], terminals [N], timeouts [N], and often infos/qpos and infos/qvel

An episode ends with the row in which `terminals` or `timeouts` is true. The action of a row is held from its
state on; the last one of an episode is not used, because the state after it is not in the file.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.episode import Episode
from planspace.demos.formats.hdf5_file import find_array, open_hdf5, read_rows
from planspace.demos.formats.observations import OBSERVATION_KEY, choose_states
from planspace.demos.recording import (
    Imported,
    ImportOptions,
    anonymous_info,
    check_options,
    recorded,
    source_name,
)
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError

OBSERVATIONS, ACTIONS, ENDS = "observations", "actions", ("terminals", "timeouts")
QPOS, QVEL = "infos/qpos", "infos/qvel"


def read_d4rl(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read a D4RL file.

    Args:
        sources: one file.
        info: the states of the planning problem. If None, the states are `qpos0`, ..., `qvel0`, ... if the
            file has `infos/qpos` and `infos/qvel`, otherwise the observations, named `state0`, ...
        options: `states` maps the name of a state to `INDEX` in `observations`, or to `ARRAY[INDEX]`, such
            as `infos/qpos[2]`; `dt` is the time step [s], which the file does not say.

    Raises:
        UsageError: there are several files, or an option does not fit the file.
        PlanspaceError: the file cannot be read, or an array is missing or does not fit.
    """
    name = source_name(sources)
    check_options(options, name, "state", "dt")
    if len(sources) > 1:
        raise UsageError(f"{name} are {len(sources)} D4RL files; import one at a time.")
    file = Path(sources[0])
    with open_hdf5(file) as opened:
        arrays = _arrays(opened, file, options)
        bounds = _bounds(opened, arrays[OBSERVATIONS].shape[0], file)
        if info is None:
            info = _info(arrays, options)
    notices = []
    if options.dt is None:
        notices.append(
            "the file does not record its time step: 1 s is assumed; `demos import --dt SECONDS` sets it."
        )
    whole = [(a, b) for a, b in bounds if b - a >= 2]
    if len(whole) < len(bounds):
        notices.append(f"{len(bounds) - len(whole)} of {len(bounds)} episodes have one state: left out.")
    return Imported(info, _episodes(file, whole, info, options), tuple(notices))


def _arrays(opened: Any, file: Path, options: ImportOptions) -> dict[str, Any]:
    """The arrays that are needed, all with the same number of rows."""
    wanted = {place.partition("[")[0] for place in options.states.values() if not place.isdigit()}
    names = dict.fromkeys([OBSERVATIONS, ACTIONS, QPOS, QVEL, *sorted(wanted)])
    found = {name: find_array(opened, name) for name in names}
    arrays = {name: array for name, array in found.items() if array is not None}
    for name in (OBSERVATIONS, ACTIONS):
        if name not in arrays:
            raise PlanspaceError(f"{file} has no array {name!r}.")
    num = arrays[OBSERVATIONS].shape[0]
    for name, array in arrays.items():
        if array.shape[0] != num:
            raise PlanspaceError(f"{file}: {name} has {array.shape[0]} rows, but observations has {num}.")
    return arrays


def _bounds(opened: Any, num: int, file: Path) -> list[tuple[int, int]]:
    """First row of each episode, and the row after its last."""
    ends = np.zeros(num, dtype=bool)
    found = [array for array in (find_array(opened, name) for name in ENDS) if array is not None]
    if not found:
        raise PlanspaceError(f"{file} has neither terminals nor timeouts, so its episodes cannot be found.")
    for array in found:
        if array.shape not in ((num,), (num, 1)):
            raise PlanspaceError(f"{file}: {array.name[1:]} has the shape {array.shape}; expected ({num},).")
        ends |= read_rows(array).reshape(num) != 0
    stops = [*(np.flatnonzero(ends) + 1).tolist(), num]
    return [(a, b) for a, b in zip([0, *stops], stops, strict=False) if b > a]


def _info(arrays: dict[str, Any], options: ImportOptions) -> StateInfo:
    sizes = {name: int(np.prod(array.shape[1:])) for name, array in arrays.items()}
    if options.states:
        names = tuple(options.states)
    elif QPOS in arrays and QVEL in arrays:
        names = (*(f"qpos{i}" for i in range(sizes[QPOS])), *(f"qvel{i}" for i in range(sizes[QVEL])))
    else:
        return anonymous_info(sizes[OBSERVATIONS], sizes[ACTIONS])
    return StateInfo(names, ("",) * len(names), (), sizes[ACTIONS])


def _episodes(
    file: Path, bounds: Sequence[tuple[int, int]], info: StateInfo, options: ImportOptions
) -> Iterator[Episode]:
    with open_hdf5(file) as opened:
        arrays = _arrays(opened, file, options)
        for i, (start, stop) in enumerate(bounds):
            rows = {name: read_rows(array, start, stop) for name, array in arrays.items()}
            states = _choose(rows, info, options, f"{file}, episode {i}")
            actions = rows[ACTIONS].reshape(stop - start, -1)
            yield recorded(states, actions[:-1], np.arange(stop - start) * (options.dt or 1.0), i)


def _choose(
    rows: dict[str, np.ndarray], info: StateInfo, options: ImportOptions, where: str
) -> Float[np.ndarray, "time state"]:
    if options.states:
        return choose_states({**rows, OBSERVATION_KEY: rows[OBSERVATIONS]}, info, options, where)
    if QPOS in rows and QVEL in rows:
        observations = np.concatenate([rows[QPOS], rows[QVEL]], axis=1)
    else:
        observations = rows[OBSERVATIONS]
    return choose_states(observations, info, options, where)
