from pathlib import Path

import pytest

from planspace.errors import PlanspaceError
from planspace.storage.runs import open_run
from planspace.storage.settings import list_differences, update_settings

RENAMED = {"trace": "gae_lambda", "fit.near": "fit.objective.short_fraction"}
ADDED = {"normalise": False, "fit.objective.margin": 0.0}


def test_settings_are_read_under_their_old_names() -> None:
    saved = {"trace": 0.97, "fit": {"near": 0.5, "steps": 10}}
    settings = update_settings(saved, renamed=RENAMED, added=ADDED)
    assert settings == {
        "gae_lambda": 0.97,
        "normalise": False,
        "fit": {"steps": 10, "objective": {"short_fraction": 0.5, "margin": 0.0}},
    }
    assert saved == {"trace": 0.97, "fit": {"near": 0.5, "steps": 10}}
    assert update_settings(settings, renamed=RENAMED, added=ADDED) == settings  # today's names stay


def test_added_settings_do_not_replace_saved_ones() -> None:
    assert update_settings({"normalise": True}, renamed={}, added={"normalise": False}) == {"normalise": True}


def test_a_path_through_a_value_is_not_found() -> None:
    saved = {"fit": 3}
    assert update_settings(saved, renamed={"fit.near": "short_fraction"}, added={}) == saved


def test_a_run_of_an_earlier_version_is_continued(tmp_path: Path) -> None:
    open_run(tmp_path / "run", {"trace": 0.97})
    now = {"gae_lambda": 0.97, "normalise": False}
    open_run(tmp_path / "run", now, renamed={"trace": "gae_lambda"}, added={"normalise": False})
    with pytest.raises(PlanspaceError, match=r"other settings: gae_lambda was 0\.97, now 0\.5\."):
        open_run(
            tmp_path / "run",
            now | {"gae_lambda": 0.5},
            renamed={"trace": "gae_lambda"},
            added={"normalise": False},
        )


def test_differences_are_listed_with_their_path() -> None:
    old, new = {"fit": {"steps": 10, "z_dim": 3}, "seed": 0}, {"fit": {"steps": 10, "z_dim": 4}, "note": "x"}
    assert list(list_differences(old, new)) == [
        "fit.z_dim was 3, now 4",
        "note was not set, now 'x'",
        "seed was 0, now not set",
    ]
