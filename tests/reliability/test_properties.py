"""Hypothesis on every reader and on a dataset that grows, crashes, is damaged and repaired."""

import contextlib
import io
import json
import os
import re
import shutil
import signal
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from planspace.cli.repair import repair
from planspace.demos.convert import import_demos
from planspace.demos.episode import Episode
from planspace.demos.folder import DemoFolder
from planspace.demos.formats.minari import write_minari
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.embed.embedding import load_embedding
from planspace.embed.training_log import read_log
from planspace.errors import PlanspaceError
from planspace.mjcf.assets import ASSETS
from planspace.mjcf.read import read_model
from planspace.rl.history import load_history
from planspace.rl.saved_policy import load_policy
from planspace.storage.arrays import read_arrays, write_arrays
from planspace.storage.checkpoint import FILE as CHECKPOINT
from planspace.storage.checkpoint import load_checkpoint, save_checkpoint
from planspace.storage.files import file_hash
from planspace.storage.json_files import json_hash, read_description, read_sealed, write_sealed
from planspace.storage.rows import append_rows
from planspace.tasks.problem_file import load_problem
from planspace.tasks.strict_yaml import StrictLoader

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
        for i, row in enumerate(rows):
            append_rows(log, [{**row, "number": i}], key="number")
        with open(log, "ab") as file:
            file.write(rest.replace(b"\n", b""))
        append_rows(log, [{"number": len(rows)}], key="number")
        lines = log.read_bytes().splitlines()
        assert [json.loads(line)["number"] for line in lines] == list(range(len(rows) + 1))


# --- files of strangers ----------------------------------------------------------------------------------

GOLDEN = Path(__file__).parents[1] / "golden" / "2026-11"
JSON_PATH = (
    '{"state_dims": ["x", "v", "control", "time"], "path": [[0, 1, 2, 0,], [1, 1, 0, 0.5], [2, 1, 1, 1]]}'
)
CSV = "episode,time,x,v,control1\n0,0,1,2,3\n0,0.5,2,3,\n1,0,1,2,3\n1,0.5,2,3,4\n1,1.1,5,6,\n"
OUT = "0 1\n1 1 2 0.5\n2 1 1 0.25\n"
Change = Callable[[bytes], bytes]
Read = Callable[[], object]

TOKENS = [
    b"",
    b"0",
    b"-1",
    b"1e999",
    b"1e308",
    b"-1e308",
    b"1e-320",
    b"9" * 30,
    b"9" * 5000,
    b"nan",
    b".inf",
    b"0x9",
]
TOKENS += [
    b"null",
    b"true",
    b"[",
    b"]",
    b"{",
    b"}",
    b"[]",
    b"{}",
    b",",
    b":",
    b'"',
    b"'",
    b"\n",
    b"\r",
    b"\t",
    b"\0",
]
TOKENS += [
    b"*a",
    b"&a ",
    b"<<",
    b"!!int",
    b"!!map",
    b"1:1",
    b"2020-01-01",
    b"#",
    b"---\n",
    b"| ",
    b"? ",
    b"\xff",
]
TOKENS += [
    b"../x",
    b"/",
    b"<",
    b"/>",
    b"&lt;",
    "é".encode(),
    b"\x1b[2J",
    b"ball",
    b"free",
    b"mesh",
    b"include",
    b"xyz",
]
NUMBERS = [0, -1, 1, 2, 3, 100, 2**31, 2**63, -(2**63), 10**30, 0.5, -0.0, 1e-320, 1e100, 1e308, -1e308]
NUMBERS += [float("nan"), float("inf"), -float("inf")]
TEXTS = ["", "a", "x", "../x", "/etc/passwd", "a\0b", "a\nb", "\ud800", "é", "1", "none", "embedding-1"]
VALUES = st.recursive(
    st.none() | st.booleans() | st.sampled_from(NUMBERS) | st.sampled_from(TEXTS),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(TEXTS), inner, max_size=2),
    max_leaves=4,
)
SHARES = st.floats(0, 1, exclude_max=True)
PLACES = st.lists(SHARES, min_size=1, max_size=5)
REMOVED = "removed"


def cut(edits: list[tuple[float, float, bytes]], data: bytes) -> bytes:
    for start, stop, instead in edits:
        data = data[: int(start * len(data))] + instead + data[int(stop * len(data)) :]
    return data


def retold(tokens: list[tuple[float, bytes]], data: bytes) -> bytes:
    """Puts tokens in the place of others."""
    for share, token in tokens:
        found = [match.span() for match in re.finditer(rb"[\w.+-]+|\S", data)]
        start, stop = found[int(share * len(found))] if found else (0, 0)
        data = data[:start] + token + data[stop:]
    return data


def revalued(changes: list[tuple[list[float], Any]], data: bytes, *, sealed: bool) -> bytes:
    """Goes down in the data of a JSON file and puts something else there; seals it as a stranger can."""
    text = json.loads(data)
    text.pop("checksum", None)
    for place, value in changes:
        inner, (*way, last) = text, place
        for share in way:
            key = nth_key(inner, share)
            if not isinstance(inner[key], dict | list) or not inner[key]:
                break
            inner = inner[key]
        if not inner:
            continue
        key = nth_key(inner, last)
        if value == REMOVED:
            del inner[key]
        else:
            inner[key] = value
    seal = {"checksum": json_hash(text)} if sealed else {}
    return (json.dumps({**text, **seal}) + "\n").encode()


def nth_key(inner: Any, share: float) -> Any:
    keys = sorted(inner) if isinstance(inner, dict) else range(len(inner))
    return keys[int(share * len(keys))]


def rearranged(
    arrays: dict[str, np.ndarray], changes: list[tuple[float, float, Any]]
) -> dict[str, np.ndarray]:
    """Arrays with other numbers, types and shapes."""
    arrays = {name: array.copy() for name, array in arrays.items()}
    for which, where, change in changes:
        name = nth_key(arrays, which)
        array = arrays[name]
        if change == REMOVED and len(arrays) > 1:
            del arrays[name]
        elif isinstance(change, str) and change != REMOVED:
            with np.errstate(all="ignore"):
                arrays[name] = array.astype(change)
        elif isinstance(change, tuple):
            arrays[name] = np.resize(array, change)
        elif isinstance(change, float) and array.size:
            with np.errstate(all="ignore"):
                array.flat[int(where * array.size)] = np.float64(change).astype(array.dtype)
    return arrays


def rearranged_npz(changes: list[tuple[float, float, Any]], data: bytes) -> bytes:
    with np.load(io.BytesIO(data)) as archive:
        arrays = rearranged(dict(archive), changes)
    np.savez_compressed(file := io.BytesIO(), **arrays)
    return file.getvalue()


def rearranged_safetensors(changes: list[tuple[float, float, Any]], data: bytes) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "f"
        file.write_bytes(data)
        size = int.from_bytes(data[:8], "little")
        about = json.loads(json.loads(data[8 : 8 + size])["__metadata__"]["planspace"])["about"]
        write_arrays(file, rearranged(read_arrays(file), changes), metadata=about)
        return file.read_bytes()


ARRAY_CHANGES = st.lists(
    st.tuples(
        SHARES,
        SHARES,
        st.sampled_from([REMOVED, "float16", "float32", "float64", "int8", "int64", "uint64", "bool"])
        | st.sampled_from([(), (0,), (1,), (3,), (0, 2), (2, 0), (3, 2), (5, 1), (2, 2, 2)])
        | st.sampled_from([float(x) for x in NUMBERS if abs(x) < 2**62 or not isinstance(x, int)]),
    ),
    min_size=1,
    max_size=3,
)
BYTES = st.builds(partial, st.just(cut), edits())
TEXT = BYTES | st.builds(
    partial, st.just(retold), st.lists(st.tuples(SHARES, st.sampled_from(TOKENS)), min_size=1, max_size=3)
)
REVALUED = st.lists(st.tuples(PLACES, VALUES | st.just(REMOVED)), min_size=1, max_size=3)
PLAIN = TEXT | st.builds(partial, st.just(partial(revalued, sealed=False)), REVALUED)
SEALED = st.builds(partial, st.just(partial(revalued, sealed=True)), REVALUED)
NPZ = BYTES | st.builds(partial, st.just(rearranged_npz), ARRAY_CHANGES)
SAFETENSORS = st.builds(partial, st.just(rearranged_safetensors), ARRAY_CHANGES)


class Loader(NamedTuple):
    """A file, what reads it, and what is done to it."""

    file: Path
    read: Read
    changes: st.SearchStrategy[Change]
    named_by_user: bool = False


def importer(
    file: Path, content: bytes, changes: st.SearchStrategy[Change], info: StateInfo | None = None
) -> Loader:
    """What is taken in can be read afterwards."""
    file.write_bytes(content)
    out = file.parent / "out"

    def read() -> None:
        shutil.rmtree(out, ignore_errors=True)
        import_demos([str(file)], out, info, ImportOptions())
        load_demos(out)

    return Loader(file, read, changes, named_by_user=True)


def make_problem(folder: Path) -> Loader:
    for name in ("arm.xml", "arm.yaml"):
        shutil.copy(ASSETS / name, folder)
    file = folder / "arm.yaml"
    return Loader(file, lambda: load_problem(str(file)), TEXT, named_by_user=True)


def make_model(folder: Path) -> Loader:
    file = Path(shutil.copy(ASSETS / "reacher.xml", folder))
    return Loader(file, lambda: read_model(file, ["joint0"]), TEXT, named_by_user=True)


def make_npz(folder: Path) -> Loader:
    arrays = {"states": np.arange(10.0).reshape(5, 2), "controls": np.zeros((5, 1)), "time": np.arange(5.0)}
    np.savez_compressed(file := io.BytesIO(), **arrays, offsets=np.array([0, 2, 5]))
    return importer(folder / "d.npz", file.getvalue(), NPZ)


def make_minari(folder: Path) -> Loader:
    pytest.importorskip("minari")
    pytest.importorskip("h5py")
    os.environ["MINARI_DATASETS_PATH"] = str(folder / "minari")
    write_minari(load_demos(GOLDEN / "demos"), "a-v0")

    def read() -> None:
        shutil.rmtree(folder / "out", ignore_errors=True)
        import_demos(["minari:a-v0"], folder / "out", None, ImportOptions())

    return Loader(folder / "minari" / "a-v0" / "data" / "metadata.json", read, PLAIN)


def make_shard(folder: Path) -> Loader:
    shutil.copytree(GOLDEN / "demos", folder / "demos")
    file = folder / "demos" / "shard-00000.safetensors"

    def read() -> None:
        manifest = read_sealed(folder / "demos" / "manifest.json")
        manifest["shards"][0]["sha256"] = file_hash(file)
        write_sealed(folder / "demos" / "manifest.json", manifest)
        load_demos(folder / "demos")

    return Loader(file, read, BYTES | SAFETENSORS)


def make_checkpoint(folder: Path) -> Loader:
    tree = {"a": np.arange(6.0).reshape(2, 3), "b": [np.zeros(2, np.float32), np.array(3)]}
    save_checkpoint(folder, tree, {"step": 3})
    return Loader(folder / CHECKPOINT, lambda: load_checkpoint(folder, tree), BYTES | SAFETENSORS)


def golden(
    name: str, read: Callable[[Path], object], changes: st.SearchStrategy[Change]
) -> Callable[[Path], Loader]:
    """A file of those that are kept, and what reads its folder."""

    def make(folder: Path) -> Loader:
        copy = shutil.copytree(GOLDEN, folder / "golden")
        file = copy / name
        return Loader(file, lambda: read(file.parent), changes)

    return make


def repairing(name: str, changes: st.SearchStrategy[Change]) -> Callable[[Path], Loader]:
    """What was repaired is whole."""

    def make(folder: Path) -> Loader:
        copy, broken = shutil.copytree(GOLDEN, folder / "golden"), folder / "broken"

        def read() -> None:
            shutil.rmtree(broken, ignore_errors=True)
            shutil.copytree(copy, broken, symlinks=True)
            repair(broken)
            assert repair(broken) == []

        return Loader(copy / name, read, changes)

    return make


def read_unit(units: Path) -> dict[str, Any]:
    return read_description(units / UNIT.name, kind="policies of a study", schema=1)


needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such files")
UNIT = next(path.relative_to(GOLDEN) for path in sorted((GOLDEN / "units").glob("policies-*.json")))
LOADERS: dict[str, Callable[[Path], Loader]] = {
    "problem": make_problem,
    "model": make_model,
    "npz": make_npz,
    "csv": lambda folder: importer(folder / "d.csv", CSV.encode(), TEXT),
    "json": lambda folder: importer(folder / "d.json", JSON_PATH.encode(), TEXT),
    "out": lambda folder: importer(folder / "d.out", OUT.encode(), TEXT, INFO),
    "minari": make_minari,
    "shard": make_shard,
    "checkpoint": make_checkpoint,
    "manifest": golden("demos/manifest.json", load_demos, SEALED),
    "embedding": golden("embedding/embedding.json", load_embedding, SEALED),
    "policies": golden("run/policies.json", load_policy, SEALED),
    "history": golden("run/history.safetensors", load_history, BYTES | SAFETENSORS),
    "log": golden("embedding/log.jsonl", read_log, TEXT),
    "unit": golden(str(UNIT), read_unit, SEALED),
}


REPAIRERS: dict[str, Callable[[Path], Loader]] = {
    "a manifest": repairing("demos/manifest.json", TEXT | SEALED),
    "a log": repairing("embedding/log.jsonl", TEXT),
    "policies": repairing("run/policies.json", SEALED),
    "a unit": repairing(str(UNIT), TEXT | SEALED),
}


def made(make: Callable[[Path], Loader], folder: Path) -> Iterator[Loader]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", "")
        patch.setattr(os, "fsync", lambda _: None)
        loader = make(folder)
        loader.read()
        yield loader


@pytest.fixture(scope="module", params=LOADERS)
def loader(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loader]:
    yield from made(LOADERS[request.param], tmp_path_factory.mktemp("loader"))


@pytest.fixture(scope="module", params=REPAIRERS)
def repairer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loader]:
    yield from made(REPAIRERS[request.param], tmp_path_factory.mktemp("repairer"))


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_what_strangers_wrote_is_read_or_refused(data: st.DataObject, loader: Loader) -> None:
    read_changed(data, loader)


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_what_strangers_wrote_is_whole_after_repair(data: st.DataObject, repairer: Loader) -> None:
    read_changed(data, repairer)


def read_changed(data: st.DataObject, loader: Loader) -> None:
    change = data.draw(loader.changes)
    whole = loader.file.read_bytes()
    loader.file.write_bytes(change(whole))
    try:
        loader.read()
        event("read")
    except PlanspaceError as error:
        event("refused")
        assert str(error).isprintable()
    finally:
        loader.file.write_bytes(whole)


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
def test_a_problem_asks_for_nothing_without_end(line: str, message: str, tmp_path: Path) -> None:
    file = make_problem(tmp_path).file
    key = line.partition(":")[0]
    kept = [other for other in file.read_text().splitlines() if not other.startswith(f"{key}:")]
    file.write_text("\n".join([*kept, line]))
    with pytest.raises(PlanspaceError, match=re.escape(message)):
        load_problem(str(file))


def test_keys_are_told_apart_in_one_pass() -> None:
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


@contextlib.contextmanager
def soon() -> Iterator[None]:
    """What waits for ever fails."""

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
def replaced(file: Path) -> Iterator[Path]:
    """A file that was put elsewhere meanwhile."""
    aside = file.parents[1] / f"aside-{file.name}"
    file.rename(aside)
    try:
        yield aside
    finally:
        file.unlink()
        aside.rename(file)


@needs_pipes
@pytest.mark.parametrize("what", ["a pipe", "a device"])
def test_what_never_ends_is_refused(what: str, loader: Loader) -> None:
    with replaced(loader.file):
        if what == "a pipe":
            os.mkfifo(loader.file)
        else:
            loader.file.symlink_to("/dev/zero")
        with soon(), pytest.raises(PlanspaceError, match="not a regular file|is a link"):
            loader.read()


def test_a_link_out_of_a_folder_of_ours_is_refused(loader: Loader) -> None:
    with replaced(loader.file) as aside:
        loader.file.symlink_to(aside)
        if loader.named_by_user:
            loader.read()
        else:
            with pytest.raises(PlanspaceError, match=rf"is a link.*to .*{aside.name}"):
                loader.read()


@needs_pipes
@pytest.mark.parametrize(
    "name", ["demos/manifest.json", "embedding/log.jsonl", "run/policies.json", "units/x.json"]
)
def test_what_never_ends_is_set_aside_by_repair(name: str, tmp_path: Path) -> None:
    file = shutil.copytree(GOLDEN, tmp_path / "golden") / name
    file.unlink(missing_ok=True)
    os.mkfifo(file)
    with soon():
        (line,) = repair(tmp_path)
        assert f"cannot read {file}: it is not a regular file" in line and repair(tmp_path) == []
    assert (file.parent / f"damaged-1-{file.name}").is_fifo()


def test_repair_leaves_what_a_link_leads_to(tmp_path: Path) -> None:
    log = shutil.copytree(GOLDEN, tmp_path / "golden") / "embedding" / "log.jsonl"
    log.unlink()
    (tmp_path / "thesis").write_text("years of work")
    log.symlink_to(tmp_path / "thesis")
    (line,) = repair(tmp_path / "golden")
    assert f"{log} is a link out of its folder, to {tmp_path / 'thesis'}" in line
    assert (tmp_path / "thesis").read_text() == "years of work" and not log.exists()


@pytest.mark.parametrize("name", ["", "..", "/", "manifest.json", "../demos"])
def test_repair_moves_no_more_than_a_shard(name: str, tmp_path: Path) -> None:
    folder = shutil.copytree(GOLDEN / "demos", tmp_path / "demos")
    manifest = read_sealed(folder / "manifest.json")
    manifest["shards"][0]["file"] = name
    write_sealed(folder / "manifest.json", manifest)
    assert len(repair(folder)) == 1 and repair(folder) == []
    assert [path.name for path in tmp_path.rglob("damaged-*")] == ["damaged-1-shard-00000.safetensors"]


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
