"""Demonstrations from and to Minari's local datasets (extra `minari`).

A Minari dataset's metadata may describe its environment by a class path. Nothing here makes that
environment: running code that a file names is how a machine is taken over.
"""

import importlib.util
import itertools
import re
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos, Episode, StateInfo, check_info
from planspace.demos.minari_files import check_files
from planspace.demos.observations import choose_states, flat
from planspace.demos.recorded_task import RecordedTask, recorded_task
from planspace.demos.recording import Imported, ImportOptions, anonymous_info, check_rising, recorded
from planspace.errors import PlanspaceError, UsageError
from planspace.storage.json_files import read_json

METADATA_KEY = "planspace"
"""Where our exporter keeps what Minari has no field for, of the dataset and of each episode."""
TIME_KEY = "time"
"""The entry of an episode's `infos` in which our exporter keeps when each state was reached [s]; a column,
because Minari 0.5 cannot read a vector back from Arrow."""
STEP_KEY = "dt"
MAX_EPISODES = 10_000_000
"""Minari makes a list of so many numbers as a file says it has episodes."""
ID_PATTERN = re.compile(r"(?:[-\w]+/)*[-\w]+-v\d+")


# --- reading ----------------------------------------------------------------------------------------


def read_minari(dataset_id: str, info: StateInfo | None, options: ImportOptions) -> Imported:
    """Reads a dataset that Minari has on this machine; nothing is downloaded.

    Args:
        dataset_id: Minari's name of it.
        info: the problem's states, if there is a problem; otherwise those our exporter wrote down, those of
            the task of ours it was recorded from, or `state0`, `state1` ... .
        options: `states` maps a name to `3`, `key[3]` or `key`; `dt` is the time step [s].

    Raises:
        UsageError: the name is malformed, or an option does not fit the dataset.
        PlanspaceError: Minari is missing, has no such dataset, or its content does not fit.
    """
    metadata, pairs = _load(dataset_id)
    ours = _our_info(metadata, dataset_id)
    if ours is not None and options.dt is not None:
        raise UsageError(f"--dt has no meaning for {dataset_id}, which has times of its own; leave it out.")
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
        # our exporter stands in for no control with one 0
        return _our_episode(states, controls[:, : ours.num_controls], data.infos, extra, where)

    episodes = (read(i, data, extra) for i, (data, extra) in enumerate(pairs))
    if info is None:
        first = next(episodes)
        info = anonymous_info(first.states.shape[1], first.controls.shape[1])
        if options.states:
            info = replace(info, names=tuple(options.states))
        episodes = itertools.chain([first], episodes)
    return Imported(info, episodes, () if ours else notices)


def _load(dataset_id: str) -> tuple[dict[str, Any], Iterator[tuple[Any, dict[str, Any]]]]:
    """The dataset's metadata, and each of its episodes in turn with the metadata it has."""
    minari = _minari()
    file = _folder(dataset_id) / "data" / "metadata.json"
    if not file.exists():
        raise PlanspaceError(
            f"Minari has no dataset {dataset_id!r} on this machine; "
            f"`minari download {dataset_id}` fetches one that is published."
        )
    with _explained(f"Minari cannot read {dataset_id!r}"):
        check_files(_folder(dataset_id))
    metadata = read_json(file)
    for key in ("observation_space", "action_space"):
        if not isinstance(metadata.get(key), str):  # Minari would make the environment to find it out
            raise PlanspaceError(
                f"{file} names no {key}; finding it would run code that the file names, which is refused."
            )
    count = metadata.get("total_episodes")
    if type(count) is not int or not 0 <= count <= MAX_EPISODES:
        raise PlanspaceError(f"{file} names no sensible number of episodes (total_episodes).")
    with _explained(f"Minari cannot read {dataset_id!r}"):
        dataset = minari.load_dataset(dataset_id)
        num = len(dataset.episode_indices)
    if num == 0:
        raise PlanspaceError(f"the Minari dataset {dataset_id!r} holds no episodes.")
    return metadata, _pairs(dataset, dataset_id)


def _pairs(dataset: Any, dataset_id: str) -> Iterator[tuple[Any, dict[str, Any]]]:
    with _explained(f"Minari cannot read {dataset_id!r}"):
        extras = dataset.storage.get_episode_metadata(dataset.episode_indices)
        yield from zip(dataset, extras, strict=True)


def _our_info(metadata: dict[str, Any], dataset_id: str) -> StateInfo | None:
    """What the states are, if our exporter wrote the dataset."""
    if METADATA_KEY not in metadata:
        return None
    try:
        known = {field.name for field in fields(StateInfo)}
        entries: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in metadata[METADATA_KEY]["info"].items()
            if key in known
        }
        info = StateInfo(**entries)
        check_info(info)
    except (KeyError, TypeError, AttributeError) as error:
        raise PlanspaceError(f"the metadata of {dataset_id!r} that planspace wrote is damaged.") from error
    except ValueError as error:
        raise PlanspaceError(
            f"the metadata of {dataset_id!r} that planspace wrote contradicts itself."
        ) from error
    return info


def _step(
    metadata: dict[str, Any], options: ImportOptions, task: RecordedTask | None
) -> tuple[float, tuple[str, ...]]:
    """The time step [s], and what to say about it."""
    if options.dt is not None:
        return options.dt, ()
    if task is not None:
        return task.step, task.notices
    step = metadata.get(STEP_KEY)
    if isinstance(step, int | float) and 0 < step < np.inf:
        return float(step), ()
    return 1.0, ("the dataset does not say how long a step lasts: 1 s is assumed; --dt SECONDS sets it.",)


def _our_episode(
    states: np.ndarray, controls: np.ndarray, infos: Any, extra: dict[str, Any], where: str
) -> Episode:
    """An episode of our exporter, with the times, goal and success that Minari has no field for."""
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
        raise PlanspaceError(f"{where}: what planspace wrote of it is damaged ({error}).") from error
    check_rising(times, lambda k: f"{where}, state {k}")
    return episode


# --- writing ----------------------------------------------------------------------------------------


def write_minari(demos: Demos, dataset_id: str) -> Path:
    """Writes a local Minari dataset that `read_minari` reads back to the same content.

    Args:
        demos: the demonstrations; states become observations, controls actions, rewards are 0.
        dataset_id: Minari's name for it, such as `cartpole/planned-v0`.

    Returns:
        The dataset's folder.

    Raises:
        UsageError: the name is malformed.
        PlanspaceError: Minari or its storage is missing, the name is taken, or it cannot be written;
            nothing is left behind.
    """
    minari = _minari()
    folder = _folder(dataset_id)
    if folder.exists():
        raise PlanspaceError(f"Minari has a dataset {dataset_id!r} already; export under another version.")
    try:
        with _explained(f"cannot write the Minari dataset {dataset_id!r}"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Minari warns of each field that has no author, link or e-mail
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
    dataset.storage.update_metadata({STEP_KEY: step, METADATA_KEY: {"info": asdict(demos.info)}})
    dataset.storage.update_episode_metadata([_extra(e) for e in episodes])


def _buffer(episode: Episode) -> Any:
    from minari.data_collector import EpisodeBuffer

    steps = len(episode.controls)
    ends = np.arange(steps) == steps - 1
    return EpisodeBuffer(
        observations=episode.states,  # pyright: ignore[reportArgumentType]  # an array does for a list
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
    """HDF5, Minari's default, where it is installed."""
    return "arrow" if importlib.util.find_spec("h5py") is None else "hdf5"


def _box(size: int) -> Any:
    from gymnasium.spaces import Box

    return Box(-np.inf, np.inf, (size,), np.float64)


# --- both -------------------------------------------------------------------------------------------


def _minari() -> ModuleType:
    try:
        import minari
    except ImportError as error:
        raise PlanspaceError("Minari is not installed: pip install 'planspace[minari]'.") from error
    return minari


def _folder(dataset_id: str) -> Path:
    """Where Minari keeps a dataset of this name."""
    from minari.storage.datasets_root_dir import get_dataset_path

    if not ID_PATTERN.fullmatch(dataset_id):
        raise UsageError(f"{dataset_id!r} is no Minari dataset; one is called NAME-vN or GROUP/NAME-vN.")
    return get_dataset_path(dataset_id)


@contextmanager
def _explained(what: str) -> Iterator[None]:
    """Turns what Minari raises on a dataset it does not like into one line."""
    try:
        yield
    except PlanspaceError:
        raise
    except Exception as error:  # what it, HDF5, Arrow and Gymnasium raise on nonsense is no short list
        raise PlanspaceError(f"{what}: {' '.join(str(error).split()) or type(error).__name__}.") from error
