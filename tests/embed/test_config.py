import json
from pathlib import Path
from typing import Any

import pytest

from planspace.embed.config import PRESETS, update_saved
from planspace.seams import plain_settings

GOLDEN = Path(__file__).parents[1] / "golden" / "2026-11"
"""Written by version 0.1.0."""
FILES = ("embedding/config.json", "embedding/embedding.json", "run/embedding/embedding.json")


def saved_settings(file: str) -> dict[str, Any]:
    content = json.loads((GOLDEN / file).read_text())
    return content["fit"] if file.endswith("config.json") else content["about"]["settings"]["fit"]


@pytest.mark.parametrize("file", FILES)
def test_settings_of_version_0_1_0_are_read_under_today_s_names(file: str) -> None:
    assert update_saved(saved_settings(file)) == {
        "preset": "modern",
        "objective": {
            "name": "variational",
            "linearity": 8.0,
            "prior": 0.1,
            "double_variance": True,
            "balance": 0.5,
            "curvature": 0.0,
            "distance": 0.0,
            "off_data_weight": 1.0,  # 0.1.0: `anywhere`; its `metric` belongs to the objective `direct`
        },
        "columns": [],
        "z_dim": 3,
        "inputs": "trig",
        "hidden": [16, 16],
        "spacings": [],
        "short_fraction": 0.5,  # 0.1.0: `near`
        "sigma_floor": 0.2,
        "steps": 60,
        "batch": 32,
        "learning_rate": 0.002,
        "decay": True,
        "clip_norm": 10.0,
        "average": 0.0,
        "z_std": 2.5,  # 0.1.0: `z_deviation`
        "whitening": 0.2,
    }


def test_settings_of_version_0_1_0_equal_those_of_the_same_config_today() -> None:
    config = PRESETS["modern"].with_settings(hidden=(16, 16), steps=60, batch=32)
    assert update_saved(saved_settings(FILES[0])) == plain_settings(config)


def test_each_objective_of_version_0_1_0_keeps_its_own_weights() -> None:
    saved = saved_settings(FILES[0])["objective"]
    expected = {
        "direct": {"metric": "l2"},
        "vae": {"prior": 0.1},
        "e2c": {"linearity": 8.0, "prior": 0.1},
        "straightening": {"linearity": 8.0, "prior": 0.1},
        "pca": {},
    }
    for name, weights in expected.items():
        assert update_saved({"objective": {**saved, "name": name}})["objective"] == {"name": name, **weights}


def test_settings_under_today_s_names_stay_as_they_are() -> None:
    for config in PRESETS.values():
        assert update_saved(plain_settings(config)) == plain_settings(config)
