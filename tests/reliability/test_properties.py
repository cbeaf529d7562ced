"""Hypothesis on every reader and on a dataset that grows, crashes, is damaged and repaired."""

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from planspace.demos.dataset import Episode, StateInfo
from planspace.demos.folder import DemoFolder, load_demos
from planspace.errors import PlanspaceError
from planspace.repair import repair
from planspace.store import append_row, is_row

from .disk import FAULTS, Dead, Fault, FaultyDisk, Interrupted
from .test_damage import assert_found, files_of

INFO = StateInfo(("x", "v"), ("m", "m/s"), (), 1)


# --- readers ---------------------------------------------------------------------------------------------


@st.composite
def edits(draw: st.DrawFn) -> list[tuple[float, float, bytes]]:
    """Stretches of a file, as shares of its length, and what stands there instead."""
    places = st.floats(0, 1)
    return [
        (*sorted((draw(places), draw(places))), draw(st.binary(max_size=40)))
        for _ in range(draw(st.integers(1, 3)))
    ]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits=edits())
def test_no_reader_is_fooled_or_falls(edits: list[tuple[float, float, bytes]], copied: Path) -> None:
    for file, read in files_of(copied).items():
        whole = data = file.read_bytes()
        for start, stop, instead in edits:
            data = data[: int(start * len(data))] + instead + data[int(stop * len(data)) :]
        if data != whole:
            file.write_bytes(data)
            assert_found(file, read, edits)
            file.write_bytes(whole)


@pytest.fixture(scope="module")
def copied(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shutil.copytree(finished, tmp_path_factory.mktemp("properties") / "out")


@given(
    st.lists(st.dictionaries(st.text(max_size=3), st.integers() | st.text(max_size=5)), max_size=4),
    st.binary(),
)
def test_a_row_that_was_cut_off_never_harms_the_next(rows: list[dict[str, Any]], rest: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.jsonl"
        for row in rows:
            append_row(log, row)
        with open(log, "ab") as file:
            file.write(rest.replace(b"\n", b""))
        append_row(log, {"after": 1})
        lines = log.read_bytes().splitlines()
        assert len(lines) == len(rows) + 1 and all(map(is_row, lines))


# --- a dataset -------------------------------------------------------------------------------------------


def episode(index: int) -> Episode:
    """Tells from its states which it is."""
    length = 2 + index % 3
    states = np.full((length, 2), float(index))
    times = np.arange(length, dtype=float)
    return Episode(states, np.zeros((length - 1, 1)), times, np.zeros(2), True, index, index)


class Dataset(RuleBasedStateMachine):
    """Appends, crashes, reopens, damages and repairs; `shards` are the indices that must be there."""

    def __init__(self) -> None:
        super().__init__()
        self.root = Path(tempfile.mkdtemp())
        self.path = self.root / "demos"
        self.shards: list[list[int]] = []

    def open(self) -> DemoFolder:
        return DemoFolder(self.path, INFO, {"seed": 0})

    def grow(self, num: int) -> list[int]:
        folder = self.open()
        indices = list(range(folder.next_index, folder.next_index + num))
        folder.append([episode(i) for i in indices], next_index=folder.next_index + num)
        return indices

    @rule(num=st.integers(1, 3))
    def append(self, num: int) -> None:
        self.shards.append(self.grow(num))

    @rule(num=st.integers(1, 2), fault=st.sampled_from(FAULTS), at=st.integers(1, 20))
    def append_and_crash(self, num: int, fault: Fault, at: int) -> None:
        first = sum(map(len, self.shards))
        try:
            with FaultyDisk(self.root, fault, at):
                self.grow(num)
        except (Dead, Interrupted, PlanspaceError):
            committed = (self.path / "manifest.json").exists() and self.open().next_index > first
        else:
            committed = True
        if committed:
            self.shards.append(list(range(first, first + num)))

    @precondition(lambda self: self.shards)
    @rule(data=st.data())
    def damage_and_repair(self, data: st.DataObject) -> None:
        number = data.draw(st.integers(0, len(self.shards) - 1))
        shard = self.path / f"shard-{number:05d}.safetensors"
        shard.write_bytes(shard.read_bytes()[: data.draw(st.integers(0, 100))])
        with pytest.raises(PlanspaceError, match=shard.name):
            load_demos(self.path)
        assert len(repair(self.path)) == 1 and repair(self.path) == []
        self.shards = self.shards[:number]

    @invariant()
    def holds_what_was_committed(self) -> None:
        indices = [i for shard in self.shards for i in shard]
        if not indices:
            return
        demos = load_demos(self.path)
        assert demos.indices.tolist() == indices
        assert demos.states[demos.offsets[:-1], 0].tolist() == indices
        assert self.open().next_index == len(indices)

    def teardown(self) -> None:
        shutil.rmtree(self.root)


TestDataset = Dataset.TestCase
TestDataset.settings = settings(max_examples=40, stateful_step_count=12, deadline=None)
