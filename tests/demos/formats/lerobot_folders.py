"""Small LeRobot datasets, written with pyarrow from the published description of the layouts."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

LENGTHS = (4, 3, 5)
FPS = 30
NAMES = ["pan.pos", "lift.pos"]
FEATURES: dict[str, Any] = {
    "observation.state": {"dtype": "float32", "shape": [2], "names": NAMES},
    "observation.effort": {"dtype": "float32", "shape": [2], "names": {"motors": ["pan", "lift"]}},
    "observation.images.top": {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "c"]},
    "action": {"dtype": "float32", "shape": [2], "names": NAMES},
    "next.reward": {"dtype": "float32", "shape": [1], "names": None},
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    **{
        key: {"dtype": "int64", "shape": [1], "names": None}
        for key in ("frame_index", "episode_index", "index", "task_index")
    },
}


def frames(episode: int, length: int) -> dict[str, np.ndarray]:
    """The columns of an episode."""
    random = np.random.default_rng(episode)
    vectors = {
        key: random.normal(size=(length, 2)).astype(np.float32)
        for key in ("observation.state", "observation.effort", "action")
    }
    rows = np.arange(length)
    return {
        **vectors,
        "next.reward": np.zeros(length, np.float32),
        "timestamp": (rows / FPS).astype(np.float32),
        "frame_index": rows,
        "episode_index": np.full(length, episode),
        "index": rows + sum(LENGTHS[:episode]),
        "task_index": np.zeros(length, int),
    }


def table(columns: dict[str, np.ndarray], fixed: bool = True):
    """An Arrow table; vectors become lists of a fixed or of any length."""
    return pyarrow.table({key: _column(array, fixed) for key, array in columns.items()})


def _column(array: np.ndarray, fixed: bool):
    if array.ndim == 1:
        return pyarrow.array(array)
    if fixed:
        return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(array.ravel()), array.shape[1])
    return pyarrow.array(array.tolist(), pyarrow.list_(pyarrow.from_numpy_dtype(array.dtype)))


def _info(root: Path, version: str, **known: Any) -> None:
    info = {
        "codebase_version": version,
        "robot_type": "so100",
        "total_episodes": len(LENGTHS),
        "total_frames": sum(LENGTHS),
        "total_tasks": 1,
        "chunks_size": 1000,
        "fps": FPS,
        "splits": {"train": "0:2", "test": "2:3"},
        "video_path": "videos/{video_key}/file.mp4",
        "features": FEATURES,
        **known,
    }
    (root / "meta").mkdir(parents=True)
    (root / "meta" / "info.json").write_text(json.dumps(info))


def write_2(root: Path, **known: Any) -> None:
    """A dataset in the layout of version 2.1, two episodes a chunk."""
    path = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    known = {"data_path": path, "chunks_size": 2, "total_videos": 0, "total_chunks": 2, **known}
    _info(root, "v2.1", **known)
    lines = [{"episode_index": i, "tasks": ["pick"], "length": n} for i, n in enumerate(LENGTHS)]
    (root / "meta" / "episodes.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (root / "meta" / "tasks.jsonl").write_text('{"task_index": 0, "task": "pick"}\n')
    for i, length in enumerate(LENGTHS):
        file = root / f"data/chunk-{i // 2:03d}/episode_{i:06d}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table(frames(i, length), fixed=i != 1), file)


def write_3(root: Path, **known: Any) -> None:
    """A dataset in the layout of version 3.0: two episodes in the first file, one in the second."""
    path = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    sizes = {"data_files_size_in_mb": 100, "video_files_size_in_mb": 500}
    _info(root, "v3.0", **{"data_path": path, **sizes, **known})
    ends = np.cumsum(LENGTHS)
    episodes = pyarrow.table(
        {
            "episode_index": [0, 1, 2],
            "tasks": [["pick"]] * 3,
            "length": LENGTHS,
            "data/chunk_index": [0, 0, 0],
            "data/file_index": [0, 0, 1],
            "dataset_from_index": ends - LENGTHS,
            "dataset_to_index": ends,
            "stats/action/min": [[0.0, 0.0]] * 3,
        }
    )
    for folder in ("meta/episodes/chunk-000", "data/chunk-000"):
        (root / folder).mkdir(parents=True)
    parquet.write_table(episodes, root / "meta/episodes/chunk-000/file-000.parquet")
    parts = [table(frames(i, length)) for i, length in enumerate(LENGTHS)]
    for i, part in enumerate((pyarrow.concat_tables(parts[:2]), parts[2])):
        parquet.write_table(part, root / f"data/chunk-000/file-{i:03d}.parquet")


def load(tmp_path: Path, name: str = "set", info: StateInfo | None = None, **options: Any) -> Demos:
    """The dataset as planspace imports it."""
    shutil.rmtree(tmp_path / "out", ignore_errors=True)
    import_demos([str(tmp_path / name)], tmp_path / "out", info, ImportOptions(**options))
    return load_demos(tmp_path / "out")
