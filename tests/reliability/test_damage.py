"""Files cut off at every length, or with a bit turned: always found, by name, with the way to repair it."""

import errno
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.cli.repair import repair
from planspace.demos.load import load_demos
from planspace.embed.embedding import load_embedding
from planspace.embed.training_log import read_log
from planspace.errors import PlanspaceError
from planspace.rl.history import load_history
from planspace.rl.saved_policy import load_policy
from planspace.storage.arrays import read_arrays, read_arrays_and_metadata
from planspace.storage.json_files import read_sealed
from planspace.study.execute import folder_of, read_result, result_file
from planspace.study.run import run_study, units_to_run

from ..tiny_study import FIT, PLANS, TINY, policy, run_alone

MAX_LENGTH, FLIPS = 4096, 2000
GOLDEN = Path(__file__).parents[1] / "golden" / "2026-11"
DESCRIBED = (
    "demos/manifest.json",
    "demos/shard-00000.safetensors",
    "embedding/embedding.safetensors",
    "run/policies.json",
    "run/history.safetensors",
    "units/plans-1b84fedd90915f34.json",
)
"""Of the golden artefacts: what is JSON, or has a header that is."""
POLICY = policy(0, z=True)


def files_of(out: Path) -> dict[Path, Callable[[], Any]]:
    """Every file that a study leaves and that is read again, with its reader."""
    plans, fitted, trained = (folder_of(unit, out) for unit in (PLANS, FIT, POLICY))
    files: dict[Path, Callable[[], Any]] = {}
    for name in ("manifest.json", "shard-00000.safetensors", "shard-00001.safetensors"):
        files[plans / name] = lambda: load_demos(plans)
    for name in ("embedding.json", "embedding.safetensors"):
        files[fitted / name] = lambda: load_embedding(fitted)
    for name in ("policies.json", "policies.safetensors"):
        files[trained / name] = lambda: load_policy(trained)
    files[trained / "history.safetensors"] = lambda: load_history(trained)
    for folder in (fitted, trained):
        path = folder / "checkpoint" / "state.safetensors"
        files[path] = lambda path=path: read_arrays_and_metadata(path)
    for unit in (PLANS, FIT, POLICY):
        files[result_file(unit, out)] = lambda unit=unit: read_result(unit, out)
    return files


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "out")


def assert_found(file: Path, read: Callable[[], Any], what: object) -> None:
    try:
        read()
    except PlanspaceError as error:
        assert str(file) in str(error) and "planspace repair" in str(error), (what, str(error))
        return
    raise AssertionError(f"{file.name}, {what}: not found")


def test_every_file_cut_off_anywhere_is_found(copied: Path) -> None:
    for file, read in files_of(copied).items():
        whole = file.read_bytes()
        read()
        with open(file, "r+b") as opened:
            for length in range(min(MAX_LENGTH, len(whole) - 1), -1, -1):
                opened.truncate(length)
                assert_found(file, read, f"cut to {length}")
        file.write_bytes(whole)


def test_two_thousand_turned_bits_are_found(copied: Path, rng: np.random.Generator) -> None:
    files = files_of(copied)
    for file, read in files.items():
        with open(file, "r+b", buffering=0) as opened:
            size = file.stat().st_size
            for place in rng.integers(size, size=FLIPS // len(files) + 1).tolist():
                opened.seek(place)
                (byte,) = opened.read(1)
                turned = byte ^ (1 << int(rng.integers(8)))
                for value, check in ((turned, True), (byte, False)):
                    opened.seek(place)
                    opened.write(bytes([value]))
                    if check:
                        assert_found(file, read, f"byte {place} made {turned:#x}")
        read()


def description_bytes(file: Path) -> int:
    """How long the part is that is JSON: all of it, or the header of a safetensors file."""
    data = file.read_bytes()
    return len(data) if file.suffix == ".json" else 8 + int.from_bytes(data[:8], "little")


def test_every_turned_bit_of_a_description_is_found(tmp_path: Path) -> None:
    """Also where a number would still read as the same, or a key that is not asked for has another name."""
    folder, num_bits = shutil.copytree(GOLDEN, tmp_path / "golden"), 0
    for file in (folder / name for name in DESCRIBED):
        read, data = (read_sealed if file.suffix == ".json" else read_arrays), bytearray(file.read_bytes())
        with open(file, "r+b", buffering=0) as opened:
            for bit in range(8 * description_bytes(file)):
                for check in (True, False):
                    data[bit // 8] ^= 1 << bit % 8
                    opened.seek(bit // 8)
                    opened.write(data[bit // 8 : bit // 8 + 1])
                    if check:
                        assert_found(file, lambda file=file, read=read: read(file), f"bit {bit}")
                        num_bits += 1
        read(file)
    assert num_bits > 60_000
    print(f"{num_bits:,} bits turned, one at a time, all found")


def test_a_file_that_the_disk_does_not_give_is_named(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read_bytes = Path.read_bytes
    for file, read in files_of(finished).items():

        def fail(path: Path, broken: Path = file) -> bytes:
            if path == broken:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return read_bytes(path)

        monkeypatch.setattr(Path, "read_bytes", fail)
        with pytest.raises(PlanspaceError) as raised:
            read()
        assert str(raised.value) == f"cannot read {file}: {os.strerror(errno.EIO)}."


# --- repair ---------------------------------------------------------------------------------------------


def content(out: Path) -> dict[str, Any]:
    plans, fitted, trained = (folder_of(unit, out) for unit in (PLANS, FIT, POLICY))
    history = {k: v.tobytes() for k, v in load_history(trained).items()}
    weights = read_arrays(trained / "policies.safetensors")
    return {
        "demos": load_demos(plans).hash,
        "embedding": load_embedding(fitted).hash,
        "log": [row["bound"] for row in read_log(fitted)],
        "history": history,
        "policies": {name: array.tobytes() for name, array in weights.items()},
    }


def damage(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 4
    file.write_bytes(data)


def damaged_names(folder: Path) -> Iterator[str]:
    return (path.name for path in folder.rglob("damaged-*"))


def test_what_was_damaged_is_made_again_as_it_was(copied: Path) -> None:
    before = content(copied)
    assert repair(copied) == []
    for file in files_of(copied):
        damage(file)
        (line,) = repair(copied)
        assert str(file) in line
        assert f"damaged-1-{file.name}" in set(damaged_names(copied)) or "shard" in file.name
        assert repair(copied) == []
        if file.parent.name == "units":
            assert len(units_to_run(TINY, copied)) == 1
            run_study(TINY, copied, workers=1)
        else:
            run_alone(next(unit for unit in (PLANS, FIT, POLICY) if unit.name in file.parts), copied)
        assert content(copied) == before, file
        for path in copied.rglob("damaged-*"):
            path.unlink()


def test_a_log_keeps_the_lines_that_can_be_read(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    log.write_bytes(b'{"step": 1}\n{"step": \xff\n{"step": 3}\n{"ste')
    with pytest.raises(PlanspaceError, match="line 2 is damaged.*`planspace repair"):
        read_log(tmp_path)
    (line,) = repair(tmp_path)
    assert f"{log} had 2 damaged lines" in line
    assert [row["step"] for row in read_log(tmp_path)] == [1, 3]


def test_what_is_no_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match="the folder .*nowhere does not exist"):
        repair(tmp_path / "nowhere")
