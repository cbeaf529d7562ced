"""Small HDF5 files in the layouts of robomimic and D4RL."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo

h5py = pytest.importorskip("h5py")

MODEL = """<mujoco><worldbody>
<body name="base"><geom size=".1" mass="1"/><joint name="turn" axis="0 1 0"/>
  <body><geom {geom} mass="1"/><joint name="limited" axis="1 0 0" range="-90 90"/></body></body>
<body name="cube"><geom size=".1" mass="1"/><freejoint name="cube_joint0"/></body>
</worldbody><actuator><motor joint="turn"/><motor joint="limited"/></actuator></mujoco>"""
WHOLE, MESH = (
    MODEL.format(geom='size=".1"'),
    MODEL.format(geom='type="mesh" mesh="hand"').replace(
        "<worldbody>", '<asset><mesh name="hand" file="/home/someone/hand.stl"/></asset><worldbody>'
    ),
)


def rows(num: int = 4) -> np.ndarray:
    """States [time, qpos, qvel] of `MODEL`."""
    states = np.random.default_rng(0).uniform(-1, 1, (num, 18))
    states[:, 6:10] = [1, 0, 0, 0]
    states[:, 0] = 3 + 0.05 * np.arange(num)
    return states


def write(file: Path, model: str = WHOLE, num_demos: int = 3, **arrays: np.ndarray) -> None:
    """A file as robomimic writes them."""
    content = {"states": rows(), "actions": np.ones((4, 2)), **arrays}
    with h5py.File(file, "w") as opened:
        data = opened.create_group("data")
        data.attrs["env_args"] = json.dumps(
            {"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 20, "robots": ["Panda"]}}
        )
        for i in (10, 2, 1)[:num_demos]:  # HDF5 sorts by text
            demo = data.create_group(f"demo_{i}")
            demo.attrs["model_file"], demo.attrs["num_samples"] = model, 4
            for key, array in content.items():
                demo.create_dataset(key, data=array, compression="gzip", shuffle=True, fletcher32=True)
            demo["actions"][0] = i
            demo.create_dataset("obs/eef_pos", data=np.arange(12.0).reshape(4, 3))
            demo.create_dataset("obs/image", data=np.zeros((4, 2, 2, 3), np.uint8))
        opened["mask/train"] = np.array([b"demo_1", b"demo_10"])


def load(tmp_path: Path, name: str = "a.hdf5", info: StateInfo | None = None, **options) -> Demos:
    shutil.rmtree(tmp_path / "out", ignore_errors=True)
    import_demos([str(tmp_path / name)], tmp_path / "out", info, ImportOptions(**options))
    return load_demos(tmp_path / "out")


def write_d4rl(file: Path, **arrays: np.ndarray | None) -> None:
    content = {
        "observations": np.arange(24.0, dtype=np.float32).reshape(8, 3),
        "actions": np.arange(8.0)[:, None],
        "rewards": np.zeros(8),
        "terminals": np.array([0, 0, 1, 0, 0, 0, 0, 0], dtype=bool),
        "timeouts": np.array([0, 0, 0, 1, 0, 0, 0, 0], dtype=bool),
        "infos/qpos": np.arange(16.0).reshape(8, 2),
        "infos/qvel": np.arange(8.0).reshape(8, 1),
        **arrays,
    }
    with h5py.File(file, "w") as opened:
        for key, array in content.items():
            if array is not None:
                opened[key] = array
        opened["metadata/algorithm"] = "SAC"
