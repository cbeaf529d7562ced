import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from planspace import load_embedding
from planspace.embed.about import read_about
from planspace.errors import PlanspaceError

GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("*/**/embedding.json"))


def saved(file: Path) -> dict[str, Any]:
    return json.loads(file.read_text())["about"]


@pytest.mark.parametrize("file", GOLDEN, ids=lambda file: "-".join(file.parts[-3:-1]))
def test_embeddings_of_earlier_versions_are_saved_again_byte_for_byte(file: Path, tmp_path: Path) -> None:
    load_embedding(file.parent).save(tmp_path / "e")
    for name in ("embedding.json", "embedding.safetensors"):
        assert (tmp_path / "e" / name).read_bytes() == (file.parent / name).read_bytes()


def test_values_of_an_embedding_of_version_0_1_0() -> None:
    about = load_embedding(GOLDEN[0].parent).require_about()
    assert (about.preset, about.seed, about.problem) == ("modern", 0, "cartpole-swingup")
    assert about.settings.seeds == (0,) and about.settings.fit["steps"] == 60
    assert about.split == {"train": (2,), "validation": (1,), "test": (0,)}
    assert about.metrics["test"]["active_dims"] == 3
    assert about.objective is None


def test_a_new_embedding_is_saved_again_byte_for_byte(embedding_folder: Path, tmp_path: Path) -> None:
    embedding = load_embedding(embedding_folder)
    embedding.save(tmp_path / "e")
    name = "embedding.json"
    assert (tmp_path / "e" / name).read_bytes() == (embedding_folder / name).read_bytes()
    assert list(saved(embedding_folder / name)) == list(embedding.require_about().plain())
    about = embedding.require_about()
    assert about.objective is not None and about.objective.name == "variational"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("seed", "0"),
        ("seed", True),
        ("settings", {}),
        ("objective", {"name": "pca"}),
        ("split", "x"),
        ("split", {"train": [2], "validation": [1]}),
        ("split", {"train": [0.5], "validation": [1], "test": [0]}),
        ("split", {"train": [None], "validation": [1], "test": [0]}),
        ("metrics", {"train": {}, "validation": {}, "test": {"straightness": "high"}}),
        ("intervals", {"test": {"straightness": [0.0]}}),
        ("metrics_of_seeds", {"x": {}}),
        ("versions", {"planspace": 1}),
    ],
)
def test_a_value_of_the_wrong_type_is_rejected(key: str, value: Any) -> None:
    with pytest.raises((KeyError, TypeError, ValueError)):
        read_about({**saved(GOLDEN[0]), key: value})


def test_an_embedding_without_a_training_record_says_so() -> None:
    assert read_about({}) is None
    with pytest.raises(PlanspaceError, match="does not say how it was trained"):
        replace(load_embedding(GOLDEN[0].parent), about=None).require_about()
