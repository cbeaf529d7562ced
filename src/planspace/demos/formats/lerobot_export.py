"""Export to LeRobot v3.0, and what LeRobot has no field for.

States and actions are stored as float64, so that nothing is rounded. LeRobot's own column `timestamp` is
float32; the column `planspace.time` has the same times in float64. `meta/planspace.json` has the meaning of
the states, the model, and the goal, success, number, seed and cost of each demonstration.
"""

import json
import math
import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.formats.lerobot_meta import EPISODE_FILES, INFO, inside
from planspace.demos.formats.parquet_file import parquet_module
from planspace.demos.state_info import StateInfo, parse_info
from planspace.errors import PlanspaceError, printable
from planspace.storage.checks import explain_write
from planspace.storage.files import TEMPORARY_PREFIX, make_folder, sync_folder, write_bytes
from planspace.storage.json_files import read_json, write_json

PREFIX = "lerobot:"
STATE, ACTION, EXACT_TIME = "observation.state", "action", "planspace.time"
"""Keys of features; the last one is planspace's own."""
OURS, SCHEMA = "meta/planspace.json", 1
FIELDS = ("goals", "success", "indices", "seeds", "costs")
"""The arrays of a `Demos` that are kept there."""
FILE_BYTES, FILE_MEGABYTES, CHUNK_FILES = 100 << 20, 100, 1000
"""LeRobot's default sizes: numbers in a file of `data`, and files in a folder."""
FILE_NAME = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
NEARLY = 1e-6
"""Relative difference below which a number of frames per second counts as whole."""

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Exported:
    """What planspace wrote beside a LeRobot dataset."""

    info: StateInfo
    """The meaning of the states."""
    fields: Mapping[str, list[Any]]
    """The arrays in `FIELDS` as lists, one entry per demonstration; unknown numbers are None."""

    def episode(
        self,
        number: int,
        states: Float[np.ndarray, "time state"],
        controls: Float[np.ndarray, "step control"],
        times: Float[np.ndarray, " time"],
        info: StateInfo,
    ) -> Episode:
        """Build a demonstration as it was exported.

        Args:
            number: its number in the dataset.
            states: T + 1 states, of which the order is that of `info`.
            controls: T controls.
            times: time of each state [s].
            info: the wanted states.

        Raises:
            PlanspaceError: the fields do not have this demonstration, or are damaged.
        """
        own = self.info.names
        try:
            goal, success, index, seed, cost = (self.fields[name][number] for name in FIELDS)
            values = np.array([math.nan if value is None else value for value in goal], dtype=float)
            if len(values) != len(own):
                raise ValueError(f"a goal has {len(values)} numbers")
            columns = [own.index(name) if name in own else i for i, name in enumerate(info.names)]
            cost = math.nan if cost is None else float(cost)
            return Episode(
                states, controls, times, values[columns], bool(success), int(index), int(seed), cost
            )
        except (LookupError, TypeError, ValueError, OverflowError) as error:
            raise PlanspaceError(f"{OURS} is damaged: demonstration {number} ({error}).") from error


def read_exported(root: Path, num_episodes: int) -> Exported | None:
    """Read what planspace wrote beside a dataset; None if another program wrote the dataset.

    Args:
        root: the dataset folder.
        num_episodes: number of episodes in the dataset.

    Raises:
        PlanspaceError: the description is damaged, or is that of another number of episodes.
    """
    if not os.path.lexists(root / OURS):
        return None
    file = inside(root, OURS)
    found = read_json(file)
    if found.get("schema") != SCHEMA:
        raise PlanspaceError(f"{file} was written by a newer planspace; upgrade planspace.")
    try:
        fields = {name: list(found[name]) for name in FIELDS}
        exported = Exported(parse_info(found["info"]), fields)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise PlanspaceError(f"{file}: the description of the states is damaged ({error}).") from error
    if any(len(values) != num_episodes for values in fields.values()):
        raise PlanspaceError(
            f"{file} describes {len(fields['goals'])} demonstrations, but the dataset has {num_episodes}; if "
            "another program changed the dataset, remove this file."
        )
    return exported


def write_lerobot(demos: Demos, target: str) -> Path:
    """Write a LeRobot v3.0 dataset. `read_lerobot` reads it back with the same numbers.

    The last action of each demonstration is zero. The task of all frames is the name of the problem.

    Args:
        demos: the demonstrations.
        target: `lerobot:DIR`; the folder must not exist, or be empty.

    Returns:
        The folder.

    Raises:
        PlanspaceError: pyarrow is not installed, the folder is not empty, or it cannot be written. Incomplete
            folders are removed.
    """
    parquet_module()
    root = Path(target.removeprefix(PREFIX))
    if root.exists() and not (root.is_dir() and not any(root.iterdir())):
        raise PlanspaceError(f"{root} already exists; export to a new folder.")
    make_folder(root.absolute().parent)
    temporary = root.absolute().parent / f"{TEMPORARY_PREFIX}{root.name}-{os.getpid()}"
    try:
        with explain_write(root):
            (temporary / "meta").mkdir(parents=True)
            _write(demos, temporary, root)
            if root.exists():
                root.rmdir()
            os.replace(temporary, root)
            sync_folder(root.absolute().parent)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return root


def _write(demos: Demos, folder: Path, target: Path) -> None:
    fps = _fps(demos, target)
    rows, totals = _write_data(demos, folder)
    task = demos.info.problem or "demonstrations"
    for row in rows:
        row["tasks"] = [task]
    _write_table(rows, folder / EPISODE_FILES / FILE_NAME.format(chunk_index=0, file_index=0))
    _write_tasks(task, folder / "meta" / "tasks.parquet")
    write_json(folder / "meta" / "stats.json", {key: _statistics(array) for key, array in totals.items()})
    write_json(folder / INFO, _description(demos, fps, list(totals)))
    fields = {name: getattr(demos, name).tolist() for name in FIELDS}
    fields["goals"] = [[_plain(number) for number in goal] for goal in fields["goals"]]
    fields["costs"] = [_plain(number) for number in fields["costs"]]
    description = {"schema": SCHEMA, "info": demos.info.plain_with_files(), **fields}
    write_bytes(folder / OURS, json.dumps(description, allow_nan=False).encode())


def _plain(number: float) -> float | None:
    return None if math.isnan(number) else number


def _fps(demos: Demos, target: Path) -> float | int:
    """Frames per second: whole if that is nearly true, as LeRobot expects."""
    steps = np.concatenate([np.diff(demos.episode(i).times) for i in range(len(demos))])
    fps = 1 / float(np.median(steps))
    if np.ptp(steps) > 1e-3 * np.median(steps):
        notice = f"the time steps are uneven; fps is {fps:.6g}, and {EXACT_TIME!r} has the times"
        print(printable(f"{target}: {notice}"), file=sys.stderr)
    return round(fps) if abs(fps - round(fps)) <= NEARLY * fps else fps


# --- data -------------------------------------------------------------------------------------------


def _write_data(demos: Demos, folder: Path) -> tuple[list[dict[str, Any]], Columns]:
    """Write the files of `data`.

    Returns:
        A row of `meta/episodes` for each demonstration, and all numbers by feature.
    """
    rows, parts = [], []
    writer, file, size, first = None, -1, 0, 0
    try:
        for i in range(len(demos)):
            columns = _columns(demos, i, first)
            num_bytes = sum(array.nbytes for array in columns.values())
            if writer is None or size + num_bytes > FILE_BYTES:
                if writer is not None:
                    writer.close()
                file, size = file + 1, 0
                writer = _open_writer(folder, file, columns)
            writer.write_table(_table(columns), row_group_size=len(columns["index"]))
            rows.append(_episode_row(i, file, first, columns))
            parts.append(columns)
            size, first = size + num_bytes, first + len(columns["index"])
    finally:
        if writer is not None:
            writer.close()
    return rows, {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _columns(demos: Demos, i: int, first: int) -> Columns:
    """The numbers of a demonstration by feature, one row per frame."""
    episode = demos.episode(i)
    num = len(episode.states)
    columns = {STATE: episode.states}
    if demos.info.num_controls:
        columns[ACTION] = np.concatenate([episode.controls, np.zeros((1, demos.info.num_controls))])
    return {
        **columns,
        EXACT_TIME: episode.times[:, None],
        "timestamp": episode.times[:, None].astype(np.float32),
        "frame_index": np.arange(num)[:, None],
        "episode_index": np.full((num, 1), i),
        "index": first + np.arange(num)[:, None],
        "task_index": np.zeros((num, 1), dtype=int),
    }


def _table(columns: Columns) -> Any:
    import pyarrow

    arrays = {}
    for key, array in columns.items():
        flat = pyarrow.array(np.ascontiguousarray(array).ravel())
        size = array.shape[1]  # LeRobot stores vectors of one number as numbers
        arrays[key] = flat if size == 1 else pyarrow.FixedSizeListArray.from_arrays(flat, size)
    return pyarrow.table(arrays)


def _open_writer(folder: Path, file: int, columns: Columns) -> Any:
    chunk, index = divmod(file, CHUNK_FILES)
    path = folder / "data" / FILE_NAME.format(chunk_index=chunk, file_index=index)
    path.parent.mkdir(parents=True, exist_ok=True)
    return parquet_module().ParquetWriter(path, _table(columns).schema, compression="snappy")


# --- meta -------------------------------------------------------------------------------------------


def _episode_row(i: int, file: int, first: int, columns: Columns) -> dict[str, Any]:
    chunk, index = divmod(file, CHUNK_FILES)
    num = len(columns["index"])
    return {
        "episode_index": i,
        "tasks": [],
        "length": num,
        "data/chunk_index": chunk,
        "data/file_index": index,
        "dataset_from_index": first,
        "dataset_to_index": first + num,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        **{
            f"stats/{key}/{name}": value
            for key, array in columns.items()
            for name, value in _statistics(array).items()
        },
    }


def _statistics(array: np.ndarray) -> dict[str, list[float | int]]:
    found = {name: getattr(np, name)(array, axis=0).tolist() for name in ("min", "max", "mean", "std")}
    quantiles = {name: np.quantile(array, q, axis=0).tolist() for name, q in QUANTILES.items()}
    return {**found, "count": [len(array)], **quantiles}


def _write_table(rows: list[dict[str, Any]], path: Path) -> None:
    import pyarrow

    path.parent.mkdir(parents=True)
    parquet_module().write_table(pyarrow.Table.from_pylist(rows), path)


def _write_tasks(task: str, path: Path) -> None:
    """Write the tasks as pandas writes a table whose index is the text of the task."""
    import pyarrow

    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    described = [
        {"name": name, "field_name": name, "pandas_type": a, "numpy_type": b, "metadata": None}
        for name, (a, b) in kinds.items()
    ]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": described}
    table = pyarrow.table({"task_index": pyarrow.array([0]), "task": [task]})
    table = table.replace_schema_metadata({"pandas": json.dumps(pandas)})
    parquet_module().write_table(table, path)


def _description(demos: Demos, fps: float | int, keys: list[str]) -> dict[str, Any]:
    """The content of `info.json`."""
    info = demos.info
    names = {STATE: list(info.names), ACTION: [f"control{i + 1}" for i in range(info.num_controls)]}
    types = {STATE: "float64", ACTION: "float64", EXACT_TIME: "float64", "timestamp": "float32"}
    return {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": len(demos),
        "total_frames": len(demos.states),
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": FILE_MEGABYTES,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(demos)}"},
        "data_path": f"data/{FILE_NAME}",
        "video_path": None,
        "features": {
            key: {
                "dtype": types.get(key, "int64"),
                "shape": [len(names.get(key, "1"))],
                "names": names.get(key),
            }
            for key in keys
        },
    }
