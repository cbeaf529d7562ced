"""Fixtures of the reliability tests. They use the golden artefacts, which need no computation."""

from pathlib import Path

import pytest

from planspace.embed.embedding import Embedding
from planspace.embed.saved_embedding import load_embedding

from .audit import CANARY
from .hostile_models import write_models
from .saved_files import GOLDEN


@pytest.fixture
def canary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the canary module importable from outside the folder that a test allows."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / f"{CANARY}.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path / "outside")


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """A folder with the files that the hostile models refer to."""
    write_models(tmp_path / "models")
    return tmp_path / "models"


@pytest.fixture
def saved_embedding(tmp_path: Path) -> Path:
    """The folder of an embedding that the present version saved."""
    golden: Embedding = load_embedding(GOLDEN / "embedding")
    golden.save(tmp_path / "embedding")
    return tmp_path / "embedding"
