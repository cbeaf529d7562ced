"""Files made to do harm: each is refused with one line that names it, and nothing else happens.

While they are read, an audit hook watches what Python opens, runs and connects to.
"""

import contextlib
import json
import struct
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.demos.convert import ImportOptions, import_demos
from planspace.demos.dataset import Demos
from planspace.demos.describe import validate
from planspace.demos.folder import DemoFolder, load_demos
from planspace.embed.embedding import Embedding, load_embedding
from planspace.errors import PlanspaceError, UsageError
from planspace.physics import apart
from planspace.physics.apart import compile_apart
from planspace.physics.mjcf import read_model
from planspace.plan.problem_file import load_problem
from planspace.rl.saved_policy import load_policy, save_policies
from planspace.store import file_hash, read_sealed, write_arrays, write_sealed

Read = Callable[[], Any]
Change = Callable[[dict[str, Any]], object]

# --- what happens meanwhile ------------------------------------------------------------------------------

WATCHED = ("open", "os.system", "os.exec", "os.posix_spawn", "os.fork", "subprocess.Popen", "socket.connect")
seen: list[tuple[str, Any]] | None = None


def _hook(event: str, details: tuple[Any, ...]) -> None:
    if seen is not None and (event in WATCHED or event.startswith("socket.")):
        seen.append((event, details))


sys.addaudithook(_hook)


@contextlib.contextmanager
def nothing_else_happens(folder: Path) -> Iterator[None]:
    """Nothing is opened but what is in this folder and Python's own, nothing run, nothing connected."""
    global seen
    seen = []
    try:
        yield
    finally:
        events, seen = seen, None
    own = [folder, *(Path(place) for place in {sys.prefix, sys.base_prefix, *sys.path} if place)]
    for event, details in events:
        assert event == "open", (event, details)
        if not isinstance(details[0], int):
            path = Path(str(details[0])).absolute()
            assert any(path.is_relative_to(place) for place in own), details


def assert_refused(folder: Path, read: Read, message: str) -> None:
    with nothing_else_happens(folder), pytest.raises(PlanspaceError, match=message) as caught:
        read()
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 2000


# --- embeddings ------------------------------------------------------------------------------------------


def raw_safetensors(header: bytes | dict[str, Any], data: bytes) -> bytes:
    head = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(head)) + head + data


def tensor(start: int, end: int, shape: list[int], dtype: str = "F64") -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "data_offsets": [start, end]}


DEEP = b'{"a":' * 100_000
SAFETENSORS = {
    "overlap": raw_safetensors({"a": tensor(0, 16, [2]), "b": tensor(8, 24, [2])}, bytes(24)),
    "hole": raw_safetensors({"a": tensor(0, 8, [1]), "b": tensor(16, 24, [1])}, bytes(24)),
    "more than there is": raw_safetensors({"a": tensor(0, 8, [1 << 40])}, bytes(8)),
    "shape overflows": raw_safetensors({"a": tensor(0, 8, [1 << 62, 1 << 62])}, bytes(8)),
    "negative offsets": raw_safetensors({"a": tensor(-8, 8, [2])}, bytes(8)),
    "enormous header": struct.pack("<Q", 1 << 62) + b"{}",
    "no JSON": raw_safetensors(b"\x80\x04\x95pickle", b""),
    "unknown type": raw_safetensors({"a": tensor(0, 8, [1], "OBJECT")}, bytes(8)),
    "deep": raw_safetensors(DEEP, b""),
    "nothing": raw_safetensors({}, b""),
}


@pytest.mark.parametrize("trick", SAFETENSORS)
def test_weights_that_are_none(trick: str, embedding: Embedding, tmp_path: Path) -> None:
    embedding.save(tmp_path / "e")
    (tmp_path / "e" / "embedding.safetensors").write_bytes(SAFETENSORS[trick])
    assert_refused(tmp_path, lambda: load_embedding(tmp_path / "e"), r"e.embedding\.safetensors was altered")
    reseal(tmp_path / "e" / "embedding.json", lambda text: None)
    assert_refused(tmp_path, lambda: load_embedding(tmp_path / "e"), r"e.embedding\.\w+ was altered")


def reseal(file: Path, change: Change) -> None:
    """Alters a description and makes its checksum anew, the weights' hash too, as a stranger can."""
    text = read_sealed(file)
    weights = file.with_suffix(".safetensors")
    if "weights_sha256" in text:
        text["weights_sha256"] = file_hash(weights)
    change(text)
    write_sealed(file, text)


def set_nan(arrays: dict[str, Any]) -> None:
    arrays["encoder.0.weight"][0, 0] = np.nan


def set_infinite(arrays: dict[str, Any]) -> None:
    arrays["decoder.0.bias"][0] = -np.inf


WEIGHTS: dict[str, tuple[Change, str]] = {
    "NaN": (set_nan, "encoder.0.weight holds a number that is not finite"),
    "infinite": (set_infinite, "decoder.0.bias holds a number that is not finite"),
    "missing": (lambda a: a.pop("encoder.1.weight"), "makes no sense"),
    "no networks": (lambda a: [a.pop(k) for k in list(a) if "coder" in k], "not whole"),
    "too large a layer": (lambda a: a.update({"encoder.0.weight": np.ones((900, 7))}), "makes no sense"),
    "no deviation": (lambda a: a.update(deviation=0 * a["deviation"]), "not whole"),
    "texts for numbers": (lambda a: a.update(mean=a["mean"].astype(bool)), "makes no sense|not whole"),
}


@pytest.mark.parametrize("trick", WEIGHTS)
def test_weights_that_do_not_compute(trick: str, embedding: Embedding, tmp_path: Path) -> None:
    change, message = WEIGHTS[trick]
    embedding.save(tmp_path / "e")
    arrays = {name: array.copy() for name, array in embedding._saved_arrays().items()}
    change(arrays)
    write_arrays(tmp_path / "e" / "embedding.safetensors", arrays)
    reseal(tmp_path / "e" / "embedding.json", lambda text: None)
    assert_refused(tmp_path, lambda: load_embedding(tmp_path / "e"), message)


DESCRIPTIONS: dict[str, tuple[Change, str]] = {
    "code for an architecture": (lambda t: t.update(architecture="os:system"), "names the architecture"),
    "a newer schema": (lambda t: t.update(schema=10**6), "written by a newer planspace"),
    "no schema": (lambda t: t.pop("schema"), "names no schema"),
    "another kind": (lambda t: t.update(kind="demos"), "describes no embedding"),
    "an unknown form": (lambda t: t["inputs"].update(form="pickle"), "makes no sense"),
    "numbers for names": (lambda t: t["inputs"].update(names=[1, 2, 3, 4]), "makes no sense"),
    "an angle that is no column": (lambda t: t["inputs"].update(circular_columns=[-9]), "no column"),
    "no inputs": (lambda t: t.pop("inputs"), "makes no sense"),
    "another size": (lambda t: t.update(z_dim=10**9), "other sizes than it says"),
}


@pytest.mark.parametrize("trick", DESCRIPTIONS)
def test_descriptions_that_lie(trick: str, embedding: Embedding, tmp_path: Path) -> None:
    change, message = DESCRIPTIONS[trick]
    embedding.save(tmp_path / "e")
    reseal(tmp_path / "e" / "embedding.json", change)
    assert_refused(tmp_path, lambda: load_embedding(tmp_path / "e"), message)


POLICIES: dict[str, Change] = {
    "an embedding elsewhere": lambda t: t.update(embeddings=["../../secret/embedding"]),
    "enormous observations": lambda t: t.update(num_obs=10**12),
    "columns that are not there": lambda t: t.update(columns=[5, 9]),
    "no seeds": lambda t: t.update(seeds=[], returns=[]),
    "texts for returns": lambda t: t.update(returns=["x"]),
}


@pytest.mark.parametrize("trick", POLICIES)
def test_policies_that_lie(trick: str, tmp_path: Path) -> None:
    arrays = {"0.weight": np.ones((1, 1, 2), np.float32), "0.bias": np.zeros((1, 1), np.float32)}
    about = {"seeds": [0], "returns": [1.0], "layer_norm": False, "columns": [0, 2], "num_obs": 2}
    about |= {"action_low": [-1.0], "action_high": [1.0], "embeddings": []}
    save_policies(tmp_path, {**arrays, "log_std": np.zeros((1, 1), np.float32)}, about)
    load_policy(tmp_path)
    reseal(tmp_path / "policies.json", POLICIES[trick])
    assert_refused(tmp_path, lambda: load_policy(tmp_path), "makes no sense")


# --- datasets --------------------------------------------------------------------------------------------


def first_shard(text: dict[str, Any]) -> dict[str, Any]:
    return text["shards"][0]


def set_diverged(states: np.ndarray) -> np.ndarray:
    states[3, 1] = np.inf
    return states


MANIFESTS: dict[str, Change] = {
    "a shard elsewhere": lambda t: first_shard(t).update(file="../../secret.safetensors"),
    "an absolute shard": lambda t: first_shard(t).update(file="/etc/passwd"),
    "a file: shard": lambda t: first_shard(t).update(file="file:///etc/passwd"),
    "more episodes than there are": lambda t: first_shard(t).update(episodes=10**15),
    "texts for sizes": lambda t: first_shard(t).update(states="many"),
    "no shards at all": lambda t: t.pop("shards"),
    "a shard that is no shard": lambda t: t.update(shards=[None]),
    "numbers for names": lambda t: t["info"].update(names=[1, 2, 3, 4]),
    "another number of states": lambda t: t["info"].update(names=["a"], units=["m"], circular_columns=[]),
    "an angle that is no column": lambda t: t["info"].update(circular_columns=[99]),
    "no info": lambda t: t.pop("info"),
}


@pytest.fixture
def dataset(demos: Demos, tmp_path: Path) -> Path:
    folder = DemoFolder(tmp_path / "d", demos.info, {"seed": 0})
    folder.append([demos.episode(i) for i in range(3)], next_index=3)
    return tmp_path / "d"


@pytest.mark.parametrize("trick", MANIFESTS)
def test_manifests_that_lie(trick: str, dataset: Path, tmp_path: Path) -> None:
    reseal(dataset / "manifest.json", MANIFESTS[trick])
    assert_refused(tmp_path, lambda: load_demos(dataset), "makes no sense")


SHARDS: dict[str, Change] = {
    "diverged": lambda a: set_diverged(a["states"]),
    "offsets that turn back": lambda a: a.update(offsets=a["offsets"][::-1].copy()),
    "no controls": lambda a: a.pop("controls"),
    "texts for numbers": lambda a: a.update(times=a["times"].astype(np.uint8)),
}


@pytest.mark.parametrize("trick", SHARDS)
def test_shards_that_lie(trick: str, dataset: Path, tmp_path: Path) -> None:
    from planspace.store import read_arrays

    file = dataset / "shard-00000.safetensors"
    arrays = {name: array.copy() for name, array in read_arrays(file).items()}
    SHARDS[trick](arrays)
    write_arrays(file, arrays)
    reseal(dataset / "manifest.json", lambda text: first_shard(text).update(sha256=file_hash(file)))
    assert_refused(tmp_path, lambda: load_demos(dataset), r"shard-00000.safetensors .*makes no sense")


@pytest.mark.parametrize(
    "text",
    [b"[" * 200_000, DEEP, b'{"schema": ' + b"9" * 50_000 + b"}\n", b"\xff\xfe{}", b"[]\n", b"", b"NaN\n"],
    ids=["deep list", "deep", "digits", "no text", "list", "empty", "NaN"],
)
def test_json_that_is_none(text: bytes, dataset: Path, tmp_path: Path) -> None:
    (dataset / "manifest.json").write_bytes(text)
    assert_refused(tmp_path, lambda: load_demos(dataset), "manifest.json was altered or damaged")


def test_archives_with_objects_in_them(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "sprung",))

    objects = np.array([Bomb()], dtype=object)
    np.savez(tmp_path / "bomb.npz", states=objects, controls=objects, offsets=objects)

    def read() -> None:
        import_demos([str(tmp_path / "bomb.npz")], tmp_path / "out", None, ImportOptions())

    assert_refused(tmp_path, read, r"bomb\.npz")
    assert not (tmp_path / "sprung").exists() and not (tmp_path / "out" / "manifest.json").exists()


# --- models ----------------------------------------------------------------------------------------------

BODY = '<body><joint/><geom size="1"/></body>'
NESTED = '<replicate count="1000">' * 4 + BODY + "</replicate>" * 4
DEEP_BODIES = "<body>" * 10_000 + "</body>" * 10_000
FLEX = '<flexcomp name="f" type="grid" count="900 900 900" spacing="1 1 1"/>'
MODELS = {
    "include outside": ('<include file="../secret.xml"/>', "outside its folder"),
    "include absolute": ('<include file="/etc/passwd"/>', "outside its folder"),
    "include file:": ('<include file="file:///etc/passwd"/>', "outside its folder"),
    "include http:": ('<include file="http://localhost/m.xml"/>', "outside its folder"),
    "include itself": ('<include file="model.xml"/>', "twice, or in a circle"),
    "include in a circle": ('<include file="loop.xml"/>', "twice, or in a circle"),
    "a link out": ('<include file="link.xml"/>', "outside its folder"),
    "mesh outside": ('<asset><mesh file="../m.stl"/></asset>', "outside its folder"),
    "mesh folder outside": ('<compiler meshdir="/etc"/><asset><mesh file="m.stl"/></asset>', "outside its"),
    "picture outside": ('<asset><texture type="2d" file="/etc/t.png"/></asset>', "outside its folder"),
    "plugin": ('<extension><plugin plugin="mujoco.sdf.bolt"/></extension>', "does not take such models"),
    "plugin alone": ("<worldbody><body><plugin/></body></worldbody>", "does not take such models"),
    "copies of copies": (f"<worldbody>{NESTED}</worldbody>", "multiplies its parts"),
    "a body of points": (f"<worldbody>{FLEX}</worldbody>", "multiplies its parts"),
    "infinitely many": ('<worldbody><replicate count="inf"/></worldbody>', "where a number belongs"),
    "deep": (f"<worldbody>{DEEP_BODIES}</worldbody>", "deep"),
    "a picture of any size": (
        '<asset><texture builtin="flat" width="900000" height="900000"/></asset>',
        "cells",
    ),
    "a field of any size": ('<asset><hfield name="h" nrow="900000" ncol="900000"/></asset>', "cells"),
    "any memory": ('<size memory="900T"/>', "reserves more"),
    "any stack": ('<size nstack="9000000000000"/>', "reserves more"),
    "any size": ('<size nuserdata="2000000000"/>', "too much"),
    "a table of any size": ('<custom><numeric name="n" size="2000000000"/></custom>', "too much"),
    "stl of 10^9 faces": ('<asset><mesh file="faces.stl"/></asset>', "its header asks for"),
    "msh of 10^9 points": ('<asset><mesh file="points.msh"/></asset>', "its header asks for"),
    "picture of 10^12 pixels": ('<asset><texture type="2d" file="pixels.png"/></asset>', "pixels"),
}
BOMB = '<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><mujoco model="&b;"/>'
OUTSIDE = '<!DOCTYPE m [<!ENTITY a SYSTEM "file:///etc/passwd">]><mujoco model="&a;"/>'


@pytest.fixture
def models(tmp_path: Path) -> Path:
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / "link.xml").symlink_to(tmp_path / "secret.xml")
    (folder / "loop.xml").write_text('<mujoco><include file="loop.xml"/></mujoco>')
    (folder / "faces.stl").write_bytes(bytes(80) + struct.pack("<I", 10**9))
    (folder / "points.msh").write_bytes(struct.pack("<4i", 10**9, 0, 0, 0))
    picture = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4s2I", 13, b"IHDR", 10**6, 10**6)
    (folder / "pixels.png").write_bytes(picture)
    return folder


@pytest.mark.parametrize("trick", MODELS)
def test_models_that_reach_out_or_ask_for_too_much(trick: str, models: Path, tmp_path: Path) -> None:
    inside, message = MODELS[trick]
    (models / "model.xml").write_text(f"<mujoco>{inside}</mujoco>")
    assert_refused(tmp_path, lambda: read_model(models / "model.xml"), message)


@pytest.mark.parametrize("text", [BOMB, OUTSIDE], ids=["bomb", "outside"])
def test_entities(text: str, models: Path, tmp_path: Path) -> None:
    (models / "model.xml").write_text(text)
    assert_refused(tmp_path, lambda: read_model(models / "model.xml"), "entities")


@pytest.mark.parametrize(
    "inside", ['<include file="/etc/passwd"/>', '<asset><mesh file="/etc/m.stl"/></asset>']
)
def test_the_model_in_a_dataset_reaches_out(inside: str, dataset: Path, tmp_path: Path) -> None:
    model = f"<mujoco>{inside}</mujoco>"
    reseal(dataset / "manifest.json", lambda text: text["info"].update(mjcf=model))
    assert_refused(tmp_path, lambda: validate(dataset, replay_controls=True), "refers to the file '/etc/")


def test_a_model_of_strangers_is_compiled_apart(models: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = f"<mujoco>{{}}<worldbody>{BODY}</worldbody></mujoco>"
    compile_apart(text.format(""))
    (models / "model.xml").write_text(text.format(""))
    assert apart.read_model_apart(models / "model.xml") == text.format("")
    with pytest.raises(PlanspaceError, match="does not compile: .*nonsense"):
        compile_apart("<mujoco><nonsense/></mujoco>")
    with pytest.raises(UsageError, match="unknown joint 'x'"):
        apart.read_model_apart(models / "model.xml", ["x"])
    greedy = text.format('<size memory="1000M"/>')
    compile_apart(greedy)
    monkeypatch.setattr(apart, "MEMORY_BYTES", 1 << 30)
    with pytest.raises(PlanspaceError, match="does not compile: .*Could not allocate memory"):
        compile_apart(greedy)
    monkeypatch.setattr(apart, "WALL_S", 0.01)
    with pytest.raises(PlanspaceError, match="does not compile within .* 1 GiB of memory"):
        compile_apart(text.format(""))


# --- problems --------------------------------------------------------------------------------------------

ALIASES = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
YAML = {
    "code": ("model: !!python/object/apply:os.system ['touch sprung']\n", "not valid YAML"),
    "a tag": ("model: !!python/name:os.system\n", "not valid YAML"),
    "aliases of aliases": (ALIASES, "unknown key"),
    "aliases in a value": ("joints: &a [*a]\n", "not valid YAML|missing|makes no sense|joints"),
    "deep": ("a: " + "[" * 100_000, "not valid YAML"),
    "large": ("# " + "x" * (1 << 20), "at most"),
    "a key twice": ("model: a\nmodel: b\n", "comes twice"),
    "a model elsewhere": (
        "model: ../secret.xml\njoints: [a]\nstart: [0]\ngoal: [0]\ntolerance: 1\n",
        "outside its folder",
    ),
}


@pytest.mark.parametrize("trick", YAML)
def test_problems_that_do_harm(trick: str, models: Path, tmp_path: Path) -> None:
    text, message = YAML[trick]
    (models / "p.yaml").write_text(text)
    assert_refused(tmp_path, lambda: load_problem(str(models / "p.yaml")), message)
    assert not list(tmp_path.rglob("sprung"))


def test_names_stay_text_in_a_page_of_paths(embedding: Embedding, demos: Demos) -> None:
    from dataclasses import replace

    from planspace.embed.plot import paths_html

    evil = "</script><script>alert(1)</script>"
    names = (evil, *demos.info.names[1:])
    inputs = replace(embedding.inputs, names=names)
    shown = replace(demos, info=replace(demos.info, names=names, problem=evil))
    page = paths_html(replace(embedding, inputs=inputs), shown, np.arange(3))
    assert evil not in page


def test_there_are_forty() -> None:
    corpus = (SAFETENSORS, WEIGHTS, DESCRIPTIONS, POLICIES, MANIFESTS, SHARDS, MODELS, YAML)
    assert sum(map(len, corpus)) >= 40
