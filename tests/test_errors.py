import json
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from planspace import errors
from planspace.errors import MAX_LENGTH, PartialResult, PlanspaceError, UsageError, printable, quoted, unknown


@pytest.mark.parametrize("text", ["a plain line", "θ̇ of the Gelenk é", "数 Ω 🙂", "'quoted' \\ back"])
def test_printable_text_is_unchanged(text: str) -> None:
    assert printable(text) == text == str(PlanspaceError(text))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[2J", r"\x1b[2J"),
        ("a\nb\r\tc", r"a\nb\r\tc"),
        ("\x9b31m", r"\x9b31m"),  # one character that some terminals treat as ESC [
        ("\u202etxt.exe", r"\u202etxt.exe"),  # the rest would appear from right to left
        ("\udc80", r"\udc80"),  # from a file name that is not UTF-8; it cannot be printed
    ],
)
def test_other_characters_are_escaped(text: str, shown: str) -> None:
    assert printable(text) == shown == printable(shown)
    assert str(UsageError(f"in {text}.")) == f"in {shown}."


def test_a_long_message_keeps_its_beginning_and_its_end() -> None:
    text = str(PlanspaceError("begins" + "x" * 10**6 + "ends"))
    assert text.startswith("begins") and text.endswith("ends") and len(text) <= MAX_LENGTH + 5
    longest = "x" * MAX_LENGTH
    assert str(PlanspaceError(longest)) == longest


def test_a_quoted_value_is_short() -> None:
    assert quoted("carpole") == "'carpole'" and quoted([1, 2]) == "[1, 2]"
    for value in ("x" * 10**5, list(range(10**5)), [["x" * 99] * 99] * 99, {"x" * 99: {1: 2}}, 10**4000):
        assert len(quoted(value)) < 600
    assert len(str(unknown("task", "x" * 10**5, ["cartpole"]))) < 200


def test_an_error_can_be_sent_between_processes() -> None:
    error = pickle.loads(pickle.dumps(PartialResult("\x1b " + "x" * 9999)))
    assert isinstance(error, PartialResult) and error.args == ("\x1b " + "x" * 9999,)


FOLDER = Path(__file__).parent


@pytest.mark.parametrize(
    ("record", "command"),
    [
        (None, "pip install 'planspace[ompl]'"),  # from a package index
        ({"url": FOLDER.as_uri(), "dir_info": {}}, f"pip install '{FOLDER}[ompl]'"),
        ({"url": FOLDER.as_uri(), "dir_info": {"editable": True}}, f"pip install -e '{FOLDER}[ompl]'"),
        ({"url": Path(__file__).as_uri(), "archive_info": {}}, f"pip install '{__file__}[ompl]'"),
        ({"url": "file:///gone", "dir_info": {}}, "pip install '.[ompl]' in a checkout of planspace"),
        (
            {"url": "https://example.org/p.git", "vcs_info": {"vcs": "git", "commit_id": "12ab"}},
            "pip install 'planspace[ompl] @ git+https://example.org/p.git@12ab'",
        ),
    ],
)
def test_extras_are_installed_from_where_planspace_came(
    record: dict | None, command: str, tmp_path: Path
) -> None:
    """`errors.py` alone, in a folder that looks like an installation, because tests run in a checkout."""
    site = tmp_path / "lib" / "site"
    about = site / "planspace-1.dist-info"
    for folder in (about, site / "planspace"):
        folder.mkdir(parents=True)
    (site / "planspace" / "__init__.py").touch()
    (about / "METADATA").write_text("Name: planspace\nVersion: 1\n")
    if record:
        (about / "direct_url.json").write_text(json.dumps(record))
    shutil.copy(errors.__file__, site / "planspace")
    code = "from planspace.errors import install_command; print(install_command('ompl'))"
    done = subprocess.run([sys.executable, "-c", code], cwd=site, capture_output=True, text=True, check=True)
    assert done.stdout == command + "\n"


def test_extras_of_a_checkout_are_installed_from_it() -> None:
    if not Path(errors.__file__).is_relative_to(FOLDER.parent):
        pytest.skip("planspace is not installed from this checkout")
    assert errors.install_command("ompl") == f"pip install -e '{FOLDER.parent}[ompl]'"
