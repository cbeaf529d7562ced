"""Robomimic's and robosuite's layout of HDF5 files.

data/demo_0/states       [T, 1 + nq + nv]  MuJoCo's flattened state: time, qpos, qvel
data/demo_0/actions      [T, m]            the action of a row is held from its state on; the last is not used
data/demo_0/obs/KEY      [T, ...]          observations
mask/KEY                                   names of demonstrations

Attributes: `env_args` (robomimic) or `env` and `env_info` (robosuite 1.0) of `data` name the environment, and
`model_file` of a demonstration has its MJCF text or the name of a file.
"""

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.episode import Episode
from planspace.demos.formats.columns import NO_CONTROLS
from planspace.demos.formats.hdf5_file import (
    find_array,
    open_hdf5,
    read_names,
    read_rows,
    read_text,
)
from planspace.demos.formats.observations import OBSERVATION_KEY, choose_states
from planspace.demos.formats.recorded_model import RecordedModel, Recording, read_recorded_model
from planspace.demos.formats.robomimic_export import (
    ACTIONS,
    DATA,
    OBSERVATIONS,
    STATES,
    exported_episode,
    exported_info,
)
from planspace.demos.recording import (
    Imported,
    ImportOptions,
    anonymous_info,
    check_rising,
    recorded,
)
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError, quoted, unknown

MASK = "mask"
MUJOCO_TYPES = (1, 2)
"""Robomimic's types of environments whose states begin with the time: robosuite and Gym."""


@dataclass(frozen=True)
class _Recorded:
    """What a file says about all of its demonstrations."""

    path: Path
    demos: tuple[str, ...]
    """Names of the groups of the demonstrations in order."""
    own: StateInfo | None
    """The meaning of the array `states`; None if there is no such array."""
    num_controls: int
    """Numbers in an action; 0 if there are no actions."""
    has_time: bool
    """Whether the first column of `states` is the time."""
    step: float | None
    """Time step that the user or the environment says [s]."""
    exported: bool
    """Whether planspace wrote the file."""
    notices: tuple[str, ...]
    masks: dict[str, list[str]] = field(default_factory=dict)
    """Names of the demonstrations in each list in `mask`, unless one of the lists was selected."""


# --- reading ----------------------------------------------------------------------------------------


def read_robomimic(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read robomimic files, or recordings of robosuite.

    Args:
        sources: at least one file.
        info: the states of the planning problem. If None, the states are named by the joints of the model
            that the file contains or names, or `state0`, `state1`, ... if there is none.
        options: `states` maps the name of a state to `COLUMN` (the name of a joint), `INDEX` in `states`, or
            `KEY` or `KEY[INDEX]` in `obs`; `dt` is the time step [s] if the file does not say it;
            `filter_key` selects the demonstrations that an array in `mask` names.

    Raises:
        UsageError: an option does not fit the file.
        PlanspaceError: the file cannot be read, or an array is missing or does not fit; the message names the
            file and the demonstration.
    """
    files = [_read_file(Path(source), options) for source in sources]
    first = files[0]
    for file in files[1:]:
        if (file.own, file.num_controls) != (first.own, first.num_controls):
            raise PlanspaceError(
                f"{file.path} has other states, actions or models than {first.path}; import each file on its "
                "own."
            )
    if info is None:
        info = _chosen_info(first, options) if options.states else first.own
    if info is None:
        raise UsageError(
            f"{first.path} has no array 'states'; choose the states with --state NAME=KEY[INDEX], where KEY "
            "is an array in 'obs'."
        )
    notices = tuple(dict.fromkeys(first.notices))
    episodes = _episodes(files, info, options)
    return Imported(info, episodes, notices, exported=first.exported, splits=_splits(files))


def _read_file(path: Path, options: ImportOptions) -> _Recorded:
    with open_hdf5(path) as opened:
        demos = _select(opened, path, options.filter_key)
        data = opened[DATA]
        own = exported_info(opened, path)
        if own is not None:
            if options.states or options.dt:
                raise UsageError(
                    f"--state and --dt cannot be used with {path.name}, which planspace exported with names "
                    "and times; leave them out."
                )
            return _Recorded(path, demos, own, own.num_controls, True, None, True, ())
        masks = _masks(opened, options.filter_key)
        first = data[demos[0]]
        states, actions = find_array(first, STATES), find_array(first, ACTIONS)
        num_controls = 0 if actions is None else int(np.prod(actions.shape[1:]))
        environment = _environment(data)
        own, has_time, notices = None, False, [] if actions is not None else [NO_CONTROLS]
        if states is not None:
            size = int(np.prod(states.shape[1:]))
            own, has_time = _own_info(_models(data, demos, path, environment), size, environment, notices)
            own = replace(own, num_controls=num_controls)
            if has_time and options.dt and _rises(read_rows(states)[:, 0]):
                raise UsageError(
                    f"--dt cannot be used with {path.name}, which has its own times; leave it out."
                )
        step = options.dt or environment.step
        if step is None and not has_time:
            step = 1.0
            notices.append(
                "the file does not record its time step: 1 s is assumed; `demos import --dt SECONDS` sets it."
            )
        return _Recorded(path, demos, own, num_controls, has_time, step, False, tuple(notices), masks)


def _masks(opened: Any, filter_key: str) -> dict[str, list[str]]:
    """The lists in `mask`; those that are no lists of names matter only if the user selects one."""
    found: dict[str, list[str]] = {}
    masks = {} if filter_key else opened.get(MASK, {})
    for key in masks:
        with suppress(PlanspaceError):
            found[str(key)] = read_names(masks, key)
    return found


def _splits(files: Sequence[_Recorded]) -> dict[str, list[int]]:
    """The numbers of the demonstrations in each list in `mask`, over all files."""
    splits: dict[str, list[int]] = {}
    first = 0
    for file in files:
        for key, names in file.masks.items():
            splits.setdefault(key, []).extend(first + i for i, n in enumerate(file.demos) if n in set(names))
        first += len(file.demos)
    return splits


def _select(opened: Any, path: Path, filter_key: str) -> tuple[str, ...]:
    """The names of the demonstrations, or of those that the user selected."""
    names = [name for name in opened[DATA] if re.fullmatch(r"demo_\d{1,9}", name)]
    names.sort(key=lambda name: int(name.partition("_")[2]))
    if filter_key:
        masks = opened.get(MASK, {})
        if filter_key not in masks:
            raise unknown("filter key", filter_key, masks)
        chosen = set(read_names(masks, filter_key))
        if missing := sorted(chosen - set(names)):
            raise PlanspaceError(
                f"{path}: {filter_key!r} names {quoted(missing[0])}, which is not in the file."
            )
        names = [name for name in names if name in chosen]
    if not names:
        raise PlanspaceError(f"{path} has no demonstrations (groups data/demo_0, data/demo_1, ...).")
    return tuple(names)


@dataclass(frozen=True)
class _Environment:
    """What the attributes of `data` say."""

    name: str
    robot: str
    step: float | None
    """Control step [s]."""
    is_mujoco: bool


def _environment(data: Any) -> _Environment:
    args, settings = _json(read_text(data, "env_args")), _json(read_text(data, "env_info"))
    inner = args.get("env_kwargs", {})
    settings = settings or (inner if isinstance(inner, dict) else {})
    name, robot = args.get("env_name") or read_text(data, "env") or "", settings.get("robots", "")
    robot = robot[0] if isinstance(robot, list) and len(robot) == 1 else robot
    frequency = settings.get("control_freq")
    step = 1 / frequency if isinstance(frequency, int | float) and 0 < frequency < np.inf else None
    is_mujoco = args.get("type") in MUJOCO_TYPES or "env_info" in data.attrs
    return _Environment(str(name), str(robot), step, is_mujoco)


def _json(text: str | None) -> dict[str, Any]:
    try:
        found = json.loads(text or "{}")
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _models(
    data: Any, demos: Sequence[str], path: Path, environment: _Environment
) -> list[RecordedModel | None]:
    """The models of all demonstrations, each once."""
    texts = dict.fromkeys(read_text(data[name], "model_file") or "" for name in demos)
    recordings = (Recording(text, path, environment.name, environment.robot) for text in texts)
    return [read_recorded_model(recording) for recording in recordings]


def _own_info(
    models: Sequence[RecordedModel | None], size: int, environment: _Environment, notices: list[str]
) -> tuple[StateInfo, bool]:
    """The meaning of `states` without the time, and whether their first column is the time."""
    model = models[0]
    if model is None:
        reason = "the file does not say which model it was recorded from"
    elif any(other is None or other.info.names != model.info.names for other in models):
        reason = "the models of the demonstrations have different joints"
    elif size - len(model.info.names) not in (0, 1):
        reason = f"a state of the model has {len(model.info.names)} numbers, but `states` has {size} columns"
    else:
        info, notice = model.info, model.notice
        if len(models) > 1 and info.source is not None:
            info = replace(info, source=None, joints=())
            notice = "the dataset has no model: the demonstrations have different models."
        notices += [notice] if notice else []
        return info, size > len(info.names)
    notices.append(f"the states are named state0, state1, ...: {reason}.")
    return anonymous_info(size - environment.is_mujoco, 0), environment.is_mujoco


def _chosen_info(file: _Recorded, options: ImportOptions) -> StateInfo:
    """Describe the states that the user chose; those that are joints keep their units and angles."""
    names, places = tuple(options.states), options.states.values()
    own = file.own or anonymous_info(0, file.num_controls)
    return own.choose(names, [own.names.index(p) if p in own.names else None for p in places])


# --- one demonstration ------------------------------------------------------------------------------


def _episodes(files: Sequence[_Recorded], info: StateInfo, options: ImportOptions) -> Iterator[Episode]:
    index = 0
    for file in files:
        with open_hdf5(file.path) as opened:
            for name in file.demos:
                yield _episode(file, opened[DATA][name], info, options, index)
                index += 1


def _episode(file: _Recorded, group: Any, info: StateInfo, options: ImportOptions, index: int) -> Episode:
    where = f"{file.path}, {group.name.rpartition('/')[2]}"
    times, rows = _states(file, group, where)
    states = _choose(file, group, rows, info, options, where)
    if len(states) < 2:
        raise PlanspaceError(f"{where} has {len(states)} states; at least two are needed.")
    if times is not None and len(times) != len(states):
        raise PlanspaceError(f"{where} has {len(times)} states and {len(states)} observations.")
    if times is None or not (_rises(times) or file.step is None):
        assert file.step is not None
        times = np.arange(len(states)) * file.step
    check_rising(times, lambda i: f"{where}, row {i}")
    controls = _controls(group, len(states), info.num_controls, where)
    if not file.exported:
        return recorded(states, controls, times, index)
    assert file.own is not None and rows is not None
    episode, own = exported_episode(group, rows, controls, times, where), file.own.names
    columns = [own.index(name) if name in own else i for i, name in enumerate(info.names)]
    return replace(episode, states=states, goal=episode.goal[columns])


def _states(
    file: _Recorded, group: Any, where: str
) -> tuple[Float[np.ndarray, " time"] | None, Float[np.ndarray, "time state"] | None]:
    """The times, if the file has them, and the array `states` without them."""
    if file.own is None:
        return None, None
    array = find_array(group, STATES)
    if array is None:
        raise PlanspaceError(f"{where} has no array 'states'.")
    rows = read_rows(array)
    wanted = len(file.own.names) + file.has_time
    if rows.ndim != 2 or rows.shape[1] != wanted:
        raise PlanspaceError(f"{where}: states has the shape {rows.shape}; expected {wanted} columns.")
    return (rows[:, 0], rows[:, 1:]) if file.has_time else (None, rows)


def _choose(
    file: _Recorded,
    group: Any,
    rows: Float[np.ndarray, "time number"] | None,
    info: StateInfo,
    options: ImportOptions,
    where: str,
) -> Float[np.ndarray, "time state"]:
    """The states that the user or the problem wants."""
    own = file.own.names if file.own and rows is not None else ()
    if not options.states and set(info.names) <= set(own):
        assert rows is not None
        return rows[:, [own.index(name) for name in info.names]]
    keyed: dict[str, Any] = {} if rows is None else {OBSERVATION_KEY: rows, STATES: rows}
    keyed |= {name: rows[:, i] for i, name in enumerate(own) if rows is not None}
    observations = group.get(OBSERVATIONS, {})
    wanted = {place.partition("[")[0] for place in options.states.values()}
    for key in observations:
        if key in wanted:
            array = find_array(observations, key)
            keyed[key] = np.empty((0, 0, 0)) if array is None else read_rows(array)
        else:
            keyed.setdefault(key, ())
    return choose_states(keyed, info, options, where)


def _controls(
    group: Any, num_states: int, num_controls: int, where: str
) -> Float[np.ndarray, "step control"]:
    array = find_array(group, ACTIONS)
    if array is None:
        return np.zeros((num_states - 1, num_controls))
    actions = read_rows(array).reshape(array.shape[0], -1)
    if len(actions) not in (num_states - 1, num_states):
        raise PlanspaceError(f"{where} has {num_states} states and {len(actions)} actions.")
    return actions[: num_states - 1]


def _rises(times: Float[np.ndarray, " time"]) -> bool:
    return bool((np.diff(times) > 0).all())
