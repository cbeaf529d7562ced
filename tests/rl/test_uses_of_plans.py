from dataclasses import replace

import pytest

from planspace.errors import UsageError
from planspace.rl.config import TrainConfig
from planspace.rl.training import train_policies
from planspace.seams import plain_settings

TASK = "cartpole-swingup"


def test_an_algorithm_without_a_replay_buffer_is_refused() -> None:
    with pytest.raises(UsageError, match=r"--replay 0.5 needs an algorithm with a replay buffer, but trpo"):
        train_policies(TASK, TrainConfig(replay=0.5))


@pytest.mark.parametrize("fraction", [-0.1, 1.1, float("nan")])
def test_a_fraction_outside_0_to_1_is_refused(fraction: float) -> None:
    with pytest.raises(UsageError, match="`replay` must be between 0 and 1"):
        TrainConfig(replay=fraction)


def test_settings_without_plans_are_saved_as_in_earlier_versions() -> None:
    config = TrainConfig()
    assert "replay" not in plain_settings(config)
    assert plain_settings(replace(config, replay=0.5))["replay"] == 0.5
