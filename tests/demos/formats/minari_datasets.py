"""Make and read Minari datasets."""

from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo

NAME = "cart/pole-v0"


def load(tmp_path: Path, name: str = NAME, info: StateInfo | None = None, **options) -> Demos:
    import_demos([f"minari:{name}"], tmp_path / "back", info, ImportOptions(**options))
    return load_demos(tmp_path / "back")


def make(minari, observations, actions, observation_space, action_space, name: str = NAME) -> None:
    """Create a dataset that planspace did not write."""
    from minari.data_collector import EpisodeBuffer

    steps = len(actions)
    buffer = EpisodeBuffer(
        observations=observations,
        actions=actions,
        rewards=[0.0] * steps,
        terminations=[False] * steps,
        truncations=[False] * (steps - 1) + [True],
    )
    with pytest.warns(UserWarning):
        minari.create_dataset_from_buffers(
            name, [buffer], observation_space=observation_space, action_space=action_space
        )


def boxes(*sizes: int):
    from gymnasium.spaces import Box

    return [Box(-np.inf, np.inf, (size,), np.float32) for size in sizes]


def make_plain(minari) -> None:
    observations = np.arange(9, dtype=np.float32).reshape(3, 3)
    make(minari, observations, np.array([[7], [8]], dtype=np.float32), *boxes(3, 1))
