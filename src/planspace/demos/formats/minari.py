"""Local Minari datasets (extra `minari`).

The metadata of a Minari dataset can name the class of its environment. This module never creates that
environment, because a file must not decide which code runs.
"""

import importlib.util
import itertools
import re
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.formats.format import Format
from planspace.demos.formats.minari_checks import check_files
from planspace.demos.formats.observations import choose_states, flat
from planspace.demos.formats.recorded_task import RecordedTask, recorded_task
from planspace.demos.recording import (
    Imported,
    ImportOptions,
    anonymous_info,
    check_options,
    check_rising,
    recorded,
)
from planspace.demos.state_info import StateInfo, parse_info
from planspace.errors import PlanspaceError, UsageError, install_command
from planspace.storage.json_files import read_json

PREFIX = "minari:"
METADATA_KEY = "planspace"
"""Where `write_minari` keeps what Minari has no field for, in the metadata of the dataset and of episodes."""
TIME_KEY = "time"
"""Entry of an episode's `infos` with the time of each state [s]. It is a column, because Minari 0.5 cannot
read a vector back from Arrow."""
STEP_KEY = "dt"
MAX_EPISODES = 10_000_000
"""Minari allocates a list whose length a file declares, so larger values are rejected."""
ID_PATTERN = re.compile(r"(?:[-\w]+/)*[-\w]+-v\d+")


# --- reading ----------------------------------------------------------------------------------------


def read_minari(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read a Minari dataset on this machine; nothing is downloaded.

    Args:
        sources: one source, `minari:ID`.
        info: the states of the planning problem. If None, the states are those that `write_minari` recorded,
            those of the planspace task that the dataset was recorded from, or `state0`, `state1`, ...
        options: `states` maps the name of a state to `3`, `key[3]` or `key`; `dt` is the time step [s].

    Raises:
        UsageError: there are several sources, the name is malformed, or an option does not fit the dataset.
        PlanspaceError: Minari is not installed, has no such dataset, or the dataset is damaged.
    """
    if len(sources) > 1:
        raise UsageError(f"{sources[0]} and {len(sources) - 1} more: import one Minari dataset at a time.")
    check_options(options, sources[0], "state", "dt")
    dataset_id = sources[0].removeprefix(PREFIX)
    metadata, pairs = _load(dataset_id)
    ours = _our_info(metadata, dataset_id)
    if ours is not None and options.dt is not None:
        raise UsageError(f"--dt cannot be used with {dataset_id}, which has its own times; leave it out.")
    task = recorded_task(metadata, dataset_id) if ours is None and not options.states else None
    step, notices = _step(metadata, options, task)
    info = info or ours or (task.info if task else None)

    def read(i: int, data: Any, extra: dict[str, Any]) -> Episode:
        where = f"{dataset_id}, episode {i}"
        if task:
            assert info is not None
            states = task.states(info, data.observations, data.infos, where)
        else:
            states = choose_states(data.observations, info, options, where)
        controls = flat(data.actions, f"the actions of {where}")
        if ours is None:
            return recorded(states, controls, np.arange(len(states)) * step, i)
        # write_minari writes a control of one 0 if there are no controls
        return _our_episode(states, controls[:, : ours.num_controls], data.infos, extra, where)

    episodes = (read(i, data, extra) for i, (data, extra) in enumerate(pairs))
    if info is None:
        first = next(episodes)
        info = anonymous_info(first.states.shape[1], first.controls.shape[1])
        if options.states:
            info = replace(info, names=tuple(options.states))
        episodes = itertools.chain([first], episodes)
    return Imported(info, episodes, () if ours else notices, exported=ours is not None)


def _load(dataset_id: str) -> tuple[Mapping[str, Any], Iterator[tuple[Any, dict[str, Any]]]]:
    """The metadata of the dataset, and its episodes with their metadata."""
    minari = _minari()
    file = _folder(dataset_id) / "data" / "metadata.json"
    if not file.exists():
        raise PlanspaceError(
            f"Minari has no dataset {dataset_id!r} on this machine; "
            f"`minari download {dataset_id}` downloads a published one."
        )
    with _explained(f"Minari cannot read {dataset_id!r}"):
        check_files(_folder(dataset_id))
    metadata = read_json(file)
    for key in ("observation_space", "action_space"):
        if not isinstance(metadata.get(key), str):  # Minari would create the environment to find out
            raise PlanspaceError(
                f"{file} has no {key}; to find it, planspace would have to run code that the file names."
            )
    count = metadata.get("total_episodes")
    if type(count) is not int or not 0 <= count <= MAX_EPISODES:
        raise PlanspaceError(f"{file} has an invalid number of episodes (total_episodes): {count!r}.")
    with _explained(f"Minari cannot read {dataset_id!r}"):
        dataset = minari.load_dataset(dataset_id)
        num = len(dataset.episode_indices)
    if num == 0:
        raise PlanspaceError(f"the Minari dataset {dataset_id!r} has no episodes.")
    return metadata, _pairs(dataset, dataset_id)


def _pairs(dataset: Any, dataset_id: str) -> Iterator[tuple[Any, dict[str, Any]]]:
    with _explained(f"Minari cannot read {dataset_id!r}"):
        extras = dataset.storage.get_episode_metadata(dataset.episode_indices)
        yield from zip(dataset, extras, strict=True)


def _our_info(metadata: Mapping[str, Any], dataset_id: str) -> StateInfo | None:
    """The meaning of the states, if `write_minari` wrote the dataset."""
    if METADATA_KEY not in metadata:
        return None
    try:
        return parse_info(metadata[METADATA_KEY]["info"])
    except (KeyError, TypeError, AttributeError) as error:
        raise PlanspaceError(f"the metadata of {dataset_id!r} that planspace wrote is damaged.") from error
    except ValueError as error:
        raise PlanspaceError(
            f"the metadata of {dataset_id!r} that planspace wrote contradicts itself."
        ) from error


def _step(
    metadata: Mapping[str, Any], options: ImportOptions, task: RecordedTask | None
) -> tuple[float, tuple[str, ...]]:
    """The time step [s], and warnings for the user."""
    if options.dt is not None:
        return options.dt, ()
    if task is not None:
        return task.step, task.notices
    step = metadata.get(STEP_KEY)
    if isinstance(step, int | float) and 0 < step < np.inf:
        return float(step), ()
    return 1.0, (
        "the dataset does not record its time step: 1 s is assumed; `demos import --dt SECONDS` sets it.",
    )


def _our_episode(
    states: np.ndarray, controls: np.ndarray, infos: Any, extra: dict[str, Any], where: str
) -> Episode:
    """An episode written by `write_minari`, with the times, goal and success that Minari has no field for."""
    prefix = f"{METADATA_KEY}_"
    try:
        times = np.asarray(infos[TIME_KEY], dtype=float).reshape(len(states))
        goal = np.full(states.shape[1], np.nan)
        goal[:] = np.asarray(extra.get(f"{prefix}goal", np.nan), dtype=float)
        success = bool(extra[f"{prefix}success"])
        index, seed = (int(np.int64(extra[prefix + key])) for key in ("index", "seed"))
        cost = float(extra.get(f"{prefix}cost", np.nan))
        episode = Episode(states, controls, times, goal, success, index, seed, cost)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise PlanspaceError(f"{where}: the metadata written by planspace are damaged ({error}).") from error
    check_rising(times, lambda k: f"{where}, state {k}")
    return episode


# --- writing ----------------------------------------------------------------------------------------


def write_minari(demos: Demos, target: str) -> Path:
    """Write a local Minari dataset. `read_minari` reads it back with the same content.

    States become observations, controls become actions, and rewards are 0.

    Args:
        demos: the demonstrations.
        target: the name of the dataset, such as `minari:cartpole/planned-v0`.

    Returns:
        The folder of the dataset.

    Raises:
        UsageError: the name is malformed.
        PlanspaceError: Minari or its storage backend is not installed, the name is taken, or the dataset
            cannot be written. Incomplete files are removed.
    """
    minari, dataset_id = _minari(), target.removeprefix(PREFIX)
    folder = _folder(dataset_id)
    if folder.exists():
        raise PlanspaceError(f"Minari already has a dataset {dataset_id!r}; choose another version.")
    try:
        with _explained(f"cannot write the Minari dataset {dataset_id!r}"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Minari warns about missing author, link and e-mail
            _create(minari, demos, dataset_id)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def _create(minari: ModuleType, demos: Demos, dataset_id: str) -> None:
    episodes = [demos.episode(i) for i in range(len(demos))]
    dataset = minari.create_dataset_from_buffers(
        dataset_id,
        [_buffer(e) for e in episodes],
        observation_space=_box(len(demos.info.names)),
        action_space=_box(max(1, demos.info.num_controls)),
        algorithm_name="planspace",
        description=f"Demonstrations of {demos.info.problem or 'an unnamed problem'}, exported by planspace.",
        data_format=_storage_format(),
    )
    step = float(np.median(np.concatenate([np.diff(e.times) for e in episodes])))
    dataset.storage.update_metadata({STEP_KEY: step, METADATA_KEY: {"info": demos.info.plain_with_files()}})
    dataset.storage.update_episode_metadata([_extra(e) for e in episodes])


def _buffer(episode: Episode) -> Any:
    from minari.data_collector import EpisodeBuffer

    steps = len(episode.controls)
    ends = np.arange(steps) == steps - 1
    return EpisodeBuffer(
        observations=episode.states,  # pyright: ignore[reportArgumentType]  # an array works like a list
        actions=episode.controls if episode.controls.shape[1] else np.zeros((steps, 1)),  # pyright: ignore
        rewards=[0.0] * steps,
        terminations=(ends & episode.success).tolist(),
        truncations=(ends & (not episode.success)).tolist(),
        infos={TIME_KEY: episode.times[:, None]},
    )


def _extra(episode: Episode) -> dict[str, Any]:
    prefix = f"{METADATA_KEY}_"
    known = {"success": episode.success, "index": episode.index, "seed": episode.seed}
    if np.isfinite(episode.goal).all():
        known["goal"] = episode.goal.tolist()
    if np.isfinite(episode.cost):
        known["cost"] = episode.cost
    return {prefix + key: value for key, value in known.items()}


def _storage_format() -> str:
    """HDF5, the default of Minari, if h5py is installed."""
    return "arrow" if importlib.util.find_spec("h5py") is None else "hdf5"


def _box(size: int) -> Any:
    from gymnasium.spaces import Box

    return Box(-np.inf, np.inf, (size,), np.float64)


# --- both -------------------------------------------------------------------------------------------


def _minari() -> ModuleType:
    try:
        import minari
    except ImportError as error:
        raise PlanspaceError(f"Minari is not installed: {install_command('minari')}.") from error
    return minari


def _folder(dataset_id: str) -> Path:
    """The folder where Minari keeps a dataset."""
    from minari.storage.datasets_root_dir import get_dataset_path

    if not ID_PATTERN.fullmatch(dataset_id):
        raise UsageError(f"{dataset_id!r} is not a Minari name; write NAME-vN or GROUP/NAME-vN.")
    return get_dataset_path(dataset_id)


@contextmanager
def _explained(what: str) -> Iterator[None]:
    """Turn any error of Minari into a `PlanspaceError` of one line."""
    try:
        yield
    except PlanspaceError:
        raise
    except Exception as error:  # Minari, HDF5, Arrow and Gymnasium raise many types
        raise PlanspaceError(f"{what}: {' '.join(str(error).split()) or type(error).__name__}.") from error


MINARI = Format(
    "minari:ID", lambda source: source.startswith(PREFIX), read_minari, write_minari, is_file=False
)
