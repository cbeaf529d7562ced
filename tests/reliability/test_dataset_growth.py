"""A dataset that grows, crashes, is damaged and repaired always holds what was committed."""

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from planspace.cli.repair import repair
from planspace.demos.episode import Episode
from planspace.demos.folder import DemoFolder
from planspace.demos.load import load_demos
from planspace.errors import PlanspaceError

from .disk import FAULTS, Dead, Fault, FaultyDisk, Interrupted
from .loaders import INFO


def episode(index: int) -> Episode:
    """An episode whose states hold its index."""
    length = 2 + index % 3
    states = np.full((length, 2), float(index))
    times = np.arange(length, dtype=float)
    return Episode(states, np.zeros((length - 1, 1)), times, np.zeros(2), True, index, index)


class Dataset(RuleBasedStateMachine):
    """Appends, crashes, reopens, damages and repairs; `shards` holds the indices that must be there."""

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


class LongDataset(Dataset):
    """The same rules, for many more runs."""


TestDataset = Dataset.TestCase
TestDataset.settings = settings(max_examples=8, stateful_step_count=10, deadline=None)
TestLongDataset = pytest.mark.nightly(LongDataset.TestCase)
TestLongDataset.settings = settings(max_examples=40, stateful_step_count=12, deadline=None)
