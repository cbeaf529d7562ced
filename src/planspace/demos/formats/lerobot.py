"""LeRobot datasets (extra `data`): a folder of Parquet files, versions 2.0, 2.1 and 3.0.

observation.state   the state
action              the action of a frame is held from its state on; the last one of an episode is not used
timestamp           the time of a frame [s] in float32
frame_index         its number in the episode

The time of a frame is its number divided by `fps`, in float64, if that agrees with the time stamps.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from planspace.demos.episode import Episode
from planspace.demos.formats.columns import NO_CONTROLS
from planspace.demos.formats.format import Format
from planspace.demos.formats.lerobot_export import (
    ACTION,
    EXACT_TIME,
    PREFIX,
    STATE,
    Exported,
    read_exported,
    write_lerobot,
)
from planspace.demos.formats.lerobot_meta import (
    EPISODE,
    FRAME,
    INDEX_FEATURES,
    INFO,
    TIME,
    DataFile,
    LeRobotMeta,
    read_meta,
)
from planspace.demos.formats.observations import OBSERVATION_KEY, choose_states
from planspace.demos.formats.parquet_file import open_parquet, read_batches
from planspace.demos.formats.reader_subprocess import read_in_subprocess
from planspace.demos.recording import Imported, ImportOptions, Use, check_options, check_rising, recorded
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError, quoted, unknown

TOLERANCE = 1e-4
"""Largest difference between a time stamp and its frame number divided by fps [s]; LeRobot's own."""
MAX_LISTED = 8
"""Number of features that a message lists."""

Arrays = dict[str, Shaped[np.ndarray, "_frame _number"]]


@dataclass(frozen=True)
class _Layout:
    """Which columns of a dataset are read."""

    meta: LeRobotMeta
    states: tuple[str, ...]
    """Features that form the state, unless the user chooses other numbers."""
    controls: tuple[str, ...]
    """Features that form the control."""
    names: tuple[str, ...]
    """Name of each number of the features in `states`."""
    columns: tuple[str, ...]
    """All columns to read."""
    exported: Exported | None
    """What planspace wrote beside it; None if another program wrote the dataset."""


def read_lerobot(sources: Sequence[str], info: StateInfo | None, options: ImportOptions) -> Imported:
    """Read a LeRobot dataset on this machine; nothing is downloaded.

    Args:
        sources: one dataset folder, with or without the prefix `lerobot:`.
        info: the states of the planning problem. If None, the states are the numbers of `observation.state`,
            with the names in `meta/info.json`.
        options: `states` maps the name of a state to one of these names, to `INDEX` in `observation.state`,
            or to `KEY` or `KEY[INDEX]`, where KEY is a feature; `filter_key` is one of the splits.

    Raises:
        UsageError: there are several sources, or an option does not fit the dataset.
        PlanspaceError: pyarrow is not installed, or a file is missing, damaged or leads out of the folder.
    """
    if len(sources) > 1:
        raise UsageError(f"{sources[0]} and {len(sources) - 1} more: import one LeRobot dataset at a time.")
    check_options(options, sources[0], "state", "filter-key")
    root = Path(sources[0].removeprefix(PREFIX))
    if options.untrusted:
        return read_in_subprocess("lerobot", [str(root)], info, options)
    meta = read_meta(root)
    exported = read_exported(root, sum(len(file.lengths) for file in meta.files))
    layout = _layout(meta, exported, options)
    own = layout.exported.info if layout.exported else _own_info(layout, options)
    files, notices = _select(layout.meta, options)
    if not layout.exported:
        notices += _left_out(layout, options)
        notices += [] if layout.controls else [NO_CONTROLS]
    numbers = [number for file in files for number in file.lengths]
    return Imported(
        info or own,
        _episodes(layout, files, info or own, options),
        tuple(notices),
        exported=exported is not None,
        uses=_uses(layout, info or own, options),
        splits={} if options.filter_key else _places(meta.splits, numbers),
    )


# --- choosing columns -------------------------------------------------------------------------------


def _layout(meta: LeRobotMeta, exported: Exported | None, options: ImportOptions) -> _Layout:
    features = meta.features
    vectors = [key for key, feature in features.items() if feature.size and key not in INDEX_FEATURES]
    states = _those(vectors, STATE, "observation")
    controls = _those(vectors, ACTION, ACTION)
    names = tuple(name for key in states for name in _number_names(meta, key))
    if len(set(names)) < len(names):
        names = tuple(f"{key}[{i}]" for key in states for i in range(features[key].size or 0))
    if exported and options.states:
        raise UsageError(
            f"--state cannot be used with {meta.root}, which planspace exported with names; leave it out."
        )
    if not states and not options.states:
        found = ", ".join(f"{key} ({feature.kind})" for key, feature in features.items())
        raise UsageError(
            f"{meta.root / INFO} has no feature {STATE!r} of numbers; choose the states with --state "
            f"NAME=KEY[INDEX]. Its features are {found}."
        )
    asked = {place.partition("[")[0] for place in options.states.values()}
    columns = [TIME, FRAME, EPISODE, *states, *controls, *sorted(asked & set(vectors))]
    columns += [EXACT_TIME] if exported else []
    wanted = tuple(dict.fromkeys(key for key in columns if key in features))
    if EPISODE not in wanted:
        raise PlanspaceError(f"{meta.root / INFO} has no feature {EPISODE!r}.")
    return _Layout(meta, states, controls, names, wanted, exported)


def _those(vectors: Sequence[str], main: str, prefix: str) -> tuple[str, ...]:
    """The main feature, or all features whose keys begin with a prefix."""
    return (main,) if main in vectors else tuple(key for key in vectors if key.startswith(prefix))


def _number_names(meta: LeRobotMeta, key: str) -> tuple[str, ...]:
    feature = meta.features[key]
    if feature.names:
        return feature.names
    return (key,) if feature.size == 1 else tuple(f"{key}[{i}]" for i in range(feature.size or 0))


def _own_info(layout: _Layout, options: ImportOptions) -> StateInfo:
    names = tuple(options.states) or layout.names
    num_controls = sum(layout.meta.features[key].size or 0 for key in layout.controls)
    return StateInfo(names, ("",) * len(names), (), num_controls)


def _left_out(layout: _Layout, options: ImportOptions) -> list[str]:
    """A notice about the features that are not read."""
    used = {*INDEX_FEATURES, *layout.controls, *layout.states}
    rest = [f"{key} ({f.kind})" for key, f in layout.meta.features.items() if key not in used]
    if not rest or options.states:
        return []
    listed = ", ".join([*rest[:MAX_LISTED], *(["..."] if len(rest) > MAX_LISTED else [])])
    return [f"left out: {listed}; --state NAME=KEY[INDEX] chooses other numbers."]


def _select(meta: LeRobotMeta, options: ImportOptions) -> tuple[list[DataFile], list[str]]:
    """The files with the chosen episodes, and what is left out."""
    split = options.filter_key
    if split and split not in meta.splits:
        raise unknown("split", split, meta.splits)
    files, num_short, total = [], 0, 0
    for file in meta.files:
        lengths = {i: n for i, n in file.lengths.items() if not split or i in meta.splits[split]}
        whole = {i: n for i, n in lengths.items() if n >= 2}
        total, num_short = total + len(lengths), num_short + len(lengths) - len(whole)
        files += [DataFile(file.path, whole)] if whole else []
    short = f"{num_short} of {total} episodes have fewer than two frames: left out."
    return files, [short] if num_short else []


def _places(splits: Mapping[str, range], numbers: Sequence[int]) -> dict[str, list[int]]:
    """The places of the episodes of each split among those that are read."""
    return {
        name: [i for i, number in enumerate(numbers) if number in found] for name, found in splits.items()
    }


def _uses(layout: _Layout, info: StateInfo, options: ImportOptions) -> tuple[Use, ...]:
    """What each feature is used for; empty if the states are not those of the dataset in their order."""
    if layout.exported or options.states or info.names != layout.names:
        return ()
    uses = [Use(TIME, "time", "s"), Use(EPISODE, "episode")]
    uses += [Use(name, "state", index=i) for i, name in enumerate(info.names)]
    names = [name for key in layout.controls for name in _number_names(layout.meta, key)]
    uses += [Use(f"{ACTION} {name}", "control", index=i) for i, name in enumerate(names)]
    used = {TIME, EPISODE, *layout.states, *layout.controls}
    rest = {key: feature for key, feature in layout.meta.features.items() if key not in used}
    return (*uses, *(Use(key, "unused", note=feature.kind) for key, feature in rest.items()))


# --- reading ----------------------------------------------------------------------------------------


def _episodes(
    layout: _Layout, files: Sequence[DataFile], info: StateInfo, options: ImportOptions
) -> Iterator[Episode]:
    count = 0
    for file in files:
        for number, arrays in _parts(file, layout.columns):
            where = f"{file.path}, episode {number}"
            times = _times(arrays, layout.meta.fps, where)
            controls = [arrays[key].astype(float) for key in layout.controls]
            joined = np.concatenate(controls, axis=1) if controls else np.zeros((len(times), 0))
            if info.num_controls and not controls:
                joined = np.zeros((len(times), info.num_controls))
            states = _states(layout, arrays, info, options, where)
            if layout.exported:
                yield layout.exported.episode(number, states, joined[:-1], times, info)
            else:
                yield recorded(states, joined[:-1], times, count)
            count += 1


def _parts(file: DataFile, columns: Sequence[str]) -> Iterator[tuple[int, Arrays]]:
    """The wanted episodes of a file; only one of them and one batch are in memory at a time."""
    missing, number, parts = dict(file.lengths), -1, []
    with open_parquet(file.path) as opened:
        for batch in read_batches(opened, columns, file.path):
            episodes = batch[EPISODE][:, 0]
            cuts = [0, *(np.flatnonzero(np.diff(episodes)) + 1).tolist(), len(episodes)]
            for start, stop in itertools.pairwise(cuts):
                if stop > start and episodes[start] != number:
                    if number in missing:
                        yield number, _joined(parts, missing.pop(number), file, number)
                    number, parts = int(episodes[start]), []
                if number in missing:
                    parts.append({key: array[start:stop] for key, array in batch.items()})
        if number in missing:
            yield number, _joined(parts, missing.pop(number), file, number)
    if missing:
        raise PlanspaceError(f"{file.path} has no episode {min(missing)}, which `meta` says is in it.")


def _joined(parts: list[Arrays], length: int, file: DataFile, number: int) -> Arrays:
    arrays = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    found = len(arrays[EPISODE])
    if found != length:
        raise PlanspaceError(
            f"{file.path} has {found} frames of episode {number}, but `meta` says {length}; the dataset was "
            "not written completely or was altered."
        )
    return arrays


def _times(arrays: Arrays, fps: float | None, where: str) -> Float[np.ndarray, " frame"]:
    if EXACT_TIME in arrays:
        return arrays[EXACT_TIME][:, 0].astype(float)
    stamps = arrays[TIME][:, 0].astype(float) if TIME in arrays else None
    frames = arrays[FRAME][:, 0].astype(float) if FRAME in arrays else None
    if fps is not None and frames is not None:
        exact = frames / fps
        if stamps is None or np.abs(stamps - exact).max() <= TOLERANCE:
            stamps = exact
    if stamps is None:
        raise PlanspaceError(f"{where} has no column {TIME!r}, and `fps` or {FRAME!r} is missing, too.")
    check_rising(stamps, lambda i: f"{where}, frame {i}")
    return stamps


def _states(
    layout: _Layout, arrays: Mapping[str, np.ndarray], info: StateInfo, options: ImportOptions, where: str
) -> Float[np.ndarray, "frame state"]:
    """The states that the user or the problem wants."""
    own = [arrays[key].astype(float) for key in layout.states]
    rows = np.concatenate(own, axis=1) if own else np.zeros((len(arrays[EPISODE]), 0))
    names = layout.exported.info.names if layout.exported else layout.names
    if len(names) != rows.shape[1]:
        raise PlanspaceError(
            f"{where}: {', '.join(map(quoted, layout.states))} has {rows.shape[1]} numbers, but `meta` says "
            f"{len(names)}."
        )
    if not options.states and set(info.names) <= set(names):
        return rows[:, [names.index(name) for name in info.names]]
    keyed = {OBSERVATION_KEY: rows} if own else {}
    keyed |= {name: rows[:, i] for i, name in enumerate(names)}
    return choose_states({**keyed, **arrays}, info, options, where)


LEROBOT = Format(
    "lerobot:DIR",
    lambda source: source.startswith(PREFIX) or (Path(source) / INFO).is_file(),
    read_lerobot,
    write_lerobot,
    is_file=False,
)
