"""This version reads what an earlier version wrote, and finds the same values in it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.cli.repair import repair
from planspace.embed.training_log import read_log

from .make import read

FOLDERS = sorted(path for path in Path(__file__).parent.iterdir() if (path / "expected.json").exists())


def assert_like(found: Any, expected: Any, where: str) -> None:
    """Compare nested values; what an earlier version did not record is None."""
    if isinstance(expected, dict):
        new = {name: found[name] for name in found.keys() - expected.keys()}
        assert found.keys() >= expected.keys() and not any(x is not None for x in new.values()), where
        for key, value in expected.items():
            assert_like(found[key], value, f"{where}.{key}")
    elif isinstance(expected, list) and expected and not isinstance(expected[0], str | dict):
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6, err_msg=where)
    else:
        assert found == expected, where


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_artefacts_of_earlier_versions_are_read(folder: Path) -> None:
    found = json.loads(json.dumps(read(folder)))
    assert_like(found, json.loads((folder / "expected.json").read_text()), folder.name)
    assert len(read_log(folder / "embedding")) >= 1
    assert repair(folder) == []


def test_the_newest_artefacts_have_the_present_schemas() -> None:
    """A new schema needs a new folder: python -m tests.golden.make tests/golden/YEAR-MONTH"""
    from planspace.demos import manifest
    from planspace.embed import saved_embedding
    from planspace.rl import saved_policy
    from planspace.study import execute

    wanted = {
        "demos/manifest.json": manifest.SCHEMA,
        "embedding/embedding.json": saved_embedding.SCHEMA,
        "run/policies.json": saved_policy.SCHEMA,
    }
    newest = FOLDERS[-1]
    for name, schema in wanted.items():
        assert json.loads((newest / name).read_text())["schema"] == schema, name
    for file in (newest / "units").iterdir():
        assert json.loads(file.read_text())["schema"] == execute.SCHEMA
