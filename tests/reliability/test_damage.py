"""Truncated files and flipped bits are always found; the error names the file and the repair."""

import errno
import os
import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from planspace.errors import PlanspaceError
from planspace.storage.arrays import read_arrays
from planspace.storage.json_files import read_sealed

from .saved_files import GOLDEN, Readers, assert_found, readers_of_golden, readers_of_study

MAX_LENGTH, NUM_FLIPS = 4096, 2000
WITH_HEADER = (
    "demos/manifest.json",
    "demos/shard-00000.safetensors",
    "embedding/embedding.safetensors",
    "run/policies.json",
    "run/history.safetensors",
    "units/plans-1b84fedd90915f34.json",
)
"""Golden files that are JSON or have a JSON header."""


@pytest.fixture
def golden(tmp_path: Path) -> Path:
    return shutil.copytree(GOLDEN, tmp_path / "golden")


@pytest.fixture
def study(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "out")


def assert_truncations_found(file: Path, read: object, lengths: Iterable[int]) -> None:
    """Truncate a file to decreasing lengths, and restore it."""
    original = file.read_bytes()
    with open(file, "r+b") as opened:
        for length in lengths:
            opened.truncate(length)
            assert_found(file, read, f"truncated to {length}")  # pyright: ignore
    file.write_bytes(original)


def test_truncated_golden_files_are_found(golden: Path) -> None:
    for file, read in readers_of_golden(golden).items():
        size = file.stat().st_size
        lengths = {size - 1, size // 2, *range(64), *range(64, size, max(size // 20, 1))}
        read()
        assert_truncations_found(file, read, sorted(lengths, reverse=True))


@pytest.mark.nightly
def test_files_truncated_at_every_length_are_found(study: Path) -> None:
    for file, read in readers_of_study(study).items():
        read()
        lengths = range(min(MAX_LENGTH, file.stat().st_size - 1), -1, -1)
        assert_truncations_found(file, read, lengths)


def assert_flips_found(files: Readers, num_flips: int, rng: np.random.Generator) -> None:
    for file, read in files.items():
        with open(file, "r+b", buffering=0) as opened:
            size = file.stat().st_size
            for place in rng.integers(size, size=num_flips // len(files) + 1).tolist():
                opened.seek(place)
                (byte,) = opened.read(1)
                flipped = byte ^ (1 << int(rng.integers(8)))
                for value, check in ((flipped, True), (byte, False)):
                    opened.seek(place)
                    opened.write(bytes([value]))
                    if check:
                        assert_found(file, read, f"byte {place} set to {flipped:#x}")
        read()


def test_flipped_bits_of_golden_files_are_found(golden: Path, rng: np.random.Generator) -> None:
    assert_flips_found(readers_of_golden(golden), NUM_FLIPS // 4, rng)


@pytest.mark.nightly
def test_two_thousand_flipped_bits_are_found(study: Path, rng: np.random.Generator) -> None:
    assert_flips_found(readers_of_study(study), NUM_FLIPS, rng)


def header_bytes(file: Path) -> int:
    """Size of the JSON part of a file: all of it, or the header of a safetensors file."""
    data = file.read_bytes()
    return len(data) if file.suffix == ".json" else 8 + int.from_bytes(data[:8], "little")


def assert_header_flips_found(folder: Path, every: int) -> int:
    """Flip every n-th bit of the headers, one at a time; returns the number of flips.

    A flip can leave a number unchanged, or rename a key that is not read; it must still be found.
    """
    num_bits = 0
    for file in (folder / name for name in WITH_HEADER):
        read, data = (read_sealed if file.suffix == ".json" else read_arrays), bytearray(file.read_bytes())
        with open(file, "r+b", buffering=0) as opened:
            for bit in range(0, 8 * header_bytes(file), every):
                for check in (True, False):
                    data[bit // 8] ^= 1 << bit % 8
                    opened.seek(bit // 8)
                    opened.write(data[bit // 8 : bit // 8 + 1])
                    if check:
                        assert_found(file, lambda file=file, read=read: read(file), f"bit {bit}")
                        num_bits += 1
        read(file)
    return num_bits


def test_flipped_bits_of_headers_are_found(golden: Path) -> None:
    assert assert_header_flips_found(golden, every=101) > 600


@pytest.mark.nightly
def test_every_flipped_bit_of_a_header_is_found(golden: Path) -> None:
    num_bits = assert_header_flips_found(golden, every=1)
    assert num_bits > 60_000
    print(f"{num_bits:,} bits flipped, one at a time, all found")


def test_an_unreadable_file_is_named(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read_bytes = Path.read_bytes
    for file, read in readers_of_golden(golden).items():

        def fail(path: Path, broken: Path = file) -> bytes:
            if path == broken:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return read_bytes(path)

        monkeypatch.setattr(Path, "read_bytes", fail)
        with pytest.raises(PlanspaceError) as raised:
            read()
        assert str(raised.value) == f"cannot read {file}: {os.strerror(errno.EIO)}."
