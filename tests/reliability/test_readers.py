"""Every reader either loads a changed file or rejects it with one of our errors."""

import contextlib
import json
import os
import re
import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planspace.errors import PlanspaceError
from planspace.storage.rows import append_rows
from planspace.tasks.problem_file import load_problem
from planspace.tasks.strict_yaml import StrictLoader

from .loaders import LOADERS, Loader, make_problem, opened, read_changed
from .mutations import Edit, edit, edits
from .saved_files import GOLDEN, Readers, assert_found, readers_of_golden, readers_of_study

needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no named pipes")


# --- edited files ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shutil.copytree(GOLDEN, tmp_path_factory.mktemp("readers") / "golden")


@pytest.fixture(scope="module")
def study(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shutil.copytree(finished, tmp_path_factory.mktemp("readers") / "study")


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits=edits())
def test_edits_of_golden_files_are_found(edits: list[Edit], golden: Path) -> None:
    assert_edits_found(edits, readers_of_golden(golden))


@pytest.mark.nightly
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits=edits())
def test_edits_of_a_studys_files_are_found(edits: list[Edit], study: Path) -> None:
    assert_edits_found(edits, readers_of_study(study))


def assert_edits_found(edits: list[Edit], files: Readers) -> None:
    for file, read in files.items():
        original = file.read_bytes()
        edited = edit(edits, original)
        if edited != original:
            file.write_bytes(edited)
            assert_found(file, read, edits)
            file.write_bytes(original)


ROWS = st.lists(st.dictionaries(st.text(max_size=3), st.integers() | st.text(max_size=5)), max_size=4)


@settings(max_examples=20, deadline=None)
@given(rows=ROWS, rest=st.binary())
def test_an_incomplete_row_does_not_harm_the_next(rows: list[dict[str, Any]], rest: bytes) -> None:
    assert_next_row_is_read(rows, rest)


@pytest.mark.nightly
@settings(deadline=None)
@given(rows=ROWS, rest=st.binary())
def test_an_incomplete_row_never_harms_the_next(rows: list[dict[str, Any]], rest: bytes) -> None:
    assert_next_row_is_read(rows, rest)


def assert_next_row_is_read(rows: list[dict[str, Any]], rest: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.jsonl"
        for i, row in enumerate(rows):
            append_rows(log, [{**row, "number": i}], key="number")
        with open(log, "ab") as file:
            file.write(rest.replace(b"\n", b""))
        append_rows(log, [{"number": len(rows)}], key="number")
        lines = log.read_bytes().splitlines()
        assert [json.loads(line)["number"] for line in lines] == list(range(len(rows) + 1))


# --- untrusted files -------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=LOADERS)
def loader(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loader]:
    yield from opened(LOADERS[request.param], tmp_path_factory.mktemp("loader"))


@settings(max_examples=8, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_an_untrusted_file_loads_or_is_rejected(data: st.DataObject, loader: Loader) -> None:
    read_changed(data, loader)


@pytest.mark.nightly
@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_many_untrusted_files_load_or_are_rejected(data: st.DataObject, loader: Loader) -> None:
    read_changed(data, loader)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("settings: {restarts: 1000000000}", "settings: restarts must be at most 100000, got 1000000000"),
        ("settings: {sst_seconds: .inf}", "settings: expected finite numbers, got inf"),
        ("cost: &a [*a]", "cost: expected a name"),
        ("settings: {a: &a [*a]}", "settings: expected finite numbers"),
        (
            "cost: " + "[&a0 [1], " + ", ".join(f"&a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 60)) + "]",
            "cost:",
        ),
    ],
)
def test_a_problem_with_endless_settings_is_rejected(line: str, message: str, tmp_path: Path) -> None:
    file = make_problem(tmp_path).file
    key = line.partition(":")[0]
    others = [other for other in file.read_text().splitlines() if not other.startswith(f"{key}:")]
    file.write_text("\n".join([*others, line]))
    with pytest.raises(PlanspaceError, match=re.escape(message)):
        load_problem(str(file))


def test_repeated_keys_are_found_in_linear_time() -> None:
    class Key(str):
        compared = 0
        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            Key.compared += 1
            return str.__eq__(self, other)

    loader, text = StrictLoader(""), "tag:yaml.org,2002:str"
    pairs = [(yaml.ScalarNode(text, Key(f"k{i}")), yaml.ScalarNode(text, "")) for i in range(1000)]
    assert len(loader.construct_mapping(yaml.MappingNode("tag:yaml.org,2002:map", pairs))) == 1000
    assert Key.compared < 10_000


# --- pipes, devices and links ----------------------------------------------------------------------------


@contextlib.contextmanager
def time_limit() -> Iterator[None]:
    """Fail if the block waits forever."""

    def give_up(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(10)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def moved_away(file: Path) -> Iterator[Path]:
    """Move a file elsewhere inside the block, and yield its new path."""
    aside = file.parents[1] / f"aside-{file.name}"
    file.rename(aside)
    try:
        yield aside
    finally:
        file.unlink()
        aside.rename(file)


@needs_pipes
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_endless_files_are_rejected(kind: str, loader: Loader) -> None:
    with moved_away(loader.file):
        if kind == "pipe":
            os.mkfifo(loader.file)
        else:
            loader.file.symlink_to("/dev/zero")
        with time_limit(), pytest.raises(PlanspaceError, match="not a regular file|is a link"):
            loader.read()


def test_a_link_out_of_a_planspace_folder_is_rejected(loader: Loader) -> None:
    with moved_away(loader.file) as aside:
        loader.file.symlink_to(aside)
        if loader.named_by_user:
            loader.read()
        else:
            with pytest.raises(PlanspaceError, match=rf"is a link.*to .*{aside.name}"):
                loader.read()
