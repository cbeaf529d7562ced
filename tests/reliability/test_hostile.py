"""Files made to do harm: each is refused with one line that names it, and nothing else happens.

While they are read, an audit hook watches what Python opens, moves, removes, imports, runs and connects to.
"""

import contextlib
import importlib
import json
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from planspace.cli import main
from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos
from planspace.demos.describe import validate
from planspace.demos.folder import DemoFolder
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.embed.embedding import Embedding, load_embedding
from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf import subprocess_model as apart
from planspace.mjcf.model_check import parse_model
from planspace.mjcf.read import read_model
from planspace.mjcf.subprocess_model import check_compiles
from planspace.rl.play import make_env
from planspace.rl.saved_policy import load_policy, save_policies
from planspace.storage.arrays import read_arrays, write_arrays
from planspace.storage.files import file_hash
from planspace.storage.json_files import read_sealed, write_sealed
from planspace.tasks.problem_file import load_problem

Read = Callable[[], Any]
Change = Callable[[dict[str, Any]], object]

# --- what happens meanwhile ------------------------------------------------------------------------------

FILES = {"open": 1, "os.remove": 1, "os.rename": 2, "os.truncate": 1, "os.mkdir": 1, "os.rmdir": 1}
"""What is done to files, and how many of an event's details are paths."""
PROGRAMS = ("os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "subprocess.Popen")
CANARY = "planspace_canary"
"""A module that nobody imports, unless a file that names it makes him."""
PYTHONS_OWN = [os.path.realpath(place) for place in (sys.prefix, sys.base_prefix, *sys.path) if place]
seen: list[tuple[str, Any]] | None = None


def _hook(event: str, details: tuple[Any, ...]) -> None:
    watched = event in FILES or event in PROGRAMS or event.startswith("socket.")
    if seen is not None and (watched or (event == "import" and details[0].startswith(CANARY))):
        seen.append((event, details))


sys.addaudithook(_hook)


@contextlib.contextmanager
def nothing_else_happens(folder: Path) -> Iterator[None]:
    """Nothing is touched but what is in this folder and Python's own, nothing run, nothing connected."""
    global seen
    seen = []
    try:
        yield
    finally:
        events, seen = seen, None
    own = [os.path.realpath(folder), *PYTHONS_OWN]
    for event, details in events:
        assert event in FILES, (event, details)
        for path in details[: FILES[event]]:
            if not isinstance(path, int):
                real = Path(os.path.realpath(os.fsdecode(path)))
                assert any(real.is_relative_to(place) for place in own), (event, details)
    assert CANARY not in sys.modules


def assert_refused(folder: Path, read: Read, message: str) -> None:
    with nothing_else_happens(folder), pytest.raises(PlanspaceError, match=message) as caught:
        read()
    assert str(caught.value).isprintable() and len(str(caught.value)) < 2000


@pytest.fixture
def canary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The canary can be imported, from outside of what a test allows."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / f"{CANARY}.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path / "outside")


DEEDS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "read": ("open", lambda secret: secret.read_text()),
    "read by a link": ("open", lambda secret: (secret.parents[1] / "allowed" / "link").read_text()),
    "written": ("open", lambda secret: secret.write_text("")),
    "removed": ("os.remove", lambda secret: secret.unlink()),
    "fetched": ("os.rename", lambda secret: secret.rename(secret.parents[1] / "allowed" / "fetched")),
    "cut off": ("os.truncate", lambda secret: os.truncate(secret, 0)),
    "a folder": ("os.mkdir", lambda secret: (secret.parent / "new").mkdir()),
    "an import": (CANARY, lambda secret: importlib.import_module(CANARY)),
    "a program": ("subprocess.Popen", lambda secret: subprocess.run([sys.executable, "-c", ""], check=True)),
    "a shell": ("os.system", lambda secret: os.system("exit 0")),
    "a socket": ("socket", lambda secret: socket.socket().close()),
}


@pytest.mark.usefixtures("canary")
@pytest.mark.parametrize("deed", DEEDS)
def test_the_hook_sees(deed: str, tmp_path: Path) -> None:
    event, act = DEEDS[deed]
    secret, allowed = tmp_path / "outside" / "secret", tmp_path / "allowed"
    secret.write_text("secret")
    allowed.mkdir()
    (allowed / "link").symlink_to(secret)
    with pytest.raises(AssertionError, match=event), nothing_else_happens(allowed):
        act(secret)
    sys.modules.pop(CANARY, None)
    with nothing_else_happens(allowed):
        (allowed / "own").write_text("")
        (allowed / "own").unlink()


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
    folder = tmp_path / "e"
    assert_refused(folder, lambda: load_embedding(folder), r"e.embedding\.safetensors was altered")
    reseal(folder / "embedding.json", lambda text: None)
    assert_refused(folder, lambda: load_embedding(folder), r"e.embedding\.\w+ was altered")


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
    "missing": (lambda a: a.pop("encoder.1.weight"), "is invalid"),
    "no networks": (lambda a: [a.pop(k) for k in list(a) if "coder" in k], "not whole"),
    "too large a layer": (lambda a: a.update({"encoder.0.weight": np.ones((900, 7))}), "is invalid"),
    "no deviation": (lambda a: a.update(deviation=0 * a["deviation"]), "not whole"),
    "texts for numbers": (lambda a: a.update(mean=a["mean"].astype(bool)), "is invalid|not whole"),
    "too large to compute with": (lambda a: a["encoder.0.weight"].fill(1e38), "what is not finite"),
    "too large to decode with": (lambda a: a["decoder.0.weight"].fill(1e38), "what is not finite"),
}


@pytest.mark.parametrize("trick", WEIGHTS)
def test_weights_that_do_not_compute(trick: str, embedding: Embedding, tmp_path: Path) -> None:
    change, message = WEIGHTS[trick]
    embedding.save(tmp_path / "e")
    arrays = {name: array.copy() for name, array in embedding._saved_arrays().items()}
    change(arrays)
    write_arrays(tmp_path / "e" / "embedding.safetensors", arrays)
    reseal(tmp_path / "e" / "embedding.json", lambda text: None)
    assert_refused(tmp_path / "e", lambda: load_embedding(tmp_path / "e"), message)


DESCRIPTIONS: dict[str, tuple[Change, str]] = {
    "code for an architecture": (lambda t: t.update(architecture="os:system"), "names the architecture"),
    "a newer schema": (lambda t: t.update(schema=10**6), "written by a newer planspace"),
    "no schema": (lambda t: t.pop("schema"), "has no schema number"),
    "another kind": (lambda t: t.update(kind="demos"), "is of kind 'demos'"),
    "an unknown form": (lambda t: t["inputs"].update(form="pickle"), "is invalid"),
    "numbers for names": (lambda t: t["inputs"].update(names=[1, 2, 3, 4]), "is invalid"),
    "an angle that is no column": (lambda t: t["inputs"].update(circular_columns=[-9]), "no column"),
    "no inputs": (lambda t: t.pop("inputs"), "is invalid"),
    "another size": (lambda t: t.update(z_dim=10**9), "other sizes than it says"),
    "another seed": (lambda t: t["about"].update(seed=99), "seed is none of those"),
}


@pytest.mark.parametrize("trick", DESCRIPTIONS)
def test_descriptions_that_lie(trick: str, embedding: Embedding, tmp_path: Path) -> None:
    change, message = DESCRIPTIONS[trick]
    embedding.save(tmp_path / "e")
    reseal(tmp_path / "e" / "embedding.json", change)
    assert_refused(tmp_path / "e", lambda: load_embedding(tmp_path / "e"), message)


FOREIGN = "names the environment .* for the task"
POLICIES: dict[str, tuple[Change, str]] = {
    "code for an environment": (lambda t: t.update(env_id=f"{CANARY}:Foo-v0"), FOREIGN),
    "code and an environment": (lambda t: t.update(env_id=f"{CANARY}:planspace/CartPole-v0"), FOREIGN),
    "code for a task": (lambda t: t.update(task=f"{CANARY}:Foo-v0"), FOREIGN),
    "code for both": (lambda t: t.update(task=f"{CANARY}:a", env_id=f"{CANARY}:a"), FOREIGN),
    "another task's environment": (lambda t: t.update(env_id="planspace/Arm-v0"), FOREIGN),
    "Gymnasium's own environment": (lambda t: t.update(task="CartPole-v1", env_id="CartPole-v1"), FOREIGN),
    "no environment at all": (lambda t: t.update(task=None, env_id=None), FOREIGN),
    "a list for an environment": (lambda t: t.update(env_id=["planspace/CartPole-v0"]), "is invalid"),
    "no environment": (lambda t: t.pop("env_id"), "is invalid .*env_id"),
    "no task": (lambda t: t.pop("task"), "is invalid .*task"),
    "an unknown form": (lambda t: t.update(obs="pickle"), "is invalid .*obs is 'pickle'"),
    "no form": (lambda t: t.pop("obs"), "is invalid .*obs is None"),
    "an unknown reward": (
        lambda t: t.update(reward="os:system"),
        "is invalid .*reward is 'os:system'",
    ),
    "z from nowhere": (lambda t: t.update(z="augment"), "is invalid .*an embedding for each seed"),
    "z to nobody": (lambda t: t.update(z_to=[1] * 9999), r"is invalid .*z_to is \[1, 1, .*\.\.\.\]"),
    "an embedding elsewhere": (
        lambda t: t.update(embeddings=["../../secret/embedding"]),
        "is invalid",
    ),
    "enormous observations": (lambda t: t.update(num_obs=10**12), "is invalid"),
    "columns that are not there": (lambda t: t.update(columns=[5, 9]), "is invalid"),
    "no seeds": (lambda t: t.update(seeds=[], returns=[]), "is invalid"),
    "a text for a seed": (lambda t: t.update(seeds=["\x1b[2J"]), "is invalid .*no whole numbers"),
    "texts for returns": (lambda t: t.update(returns=["x"]), "is invalid"),
    "actions without end": (
        lambda t: t.update(action_low=[-1e308]),
        "is invalid .*limit of its actions",
    ),
    "actions that are none": (lambda t: t.update(action_high=["pickle"]), "is invalid"),
    "no actions to choose from": (lambda t: t.update(action_low=[1.0]), "is invalid .*no range"),
}
POLICY_WEIGHTS: dict[str, tuple[Change, str]] = {
    "too large": (lambda a: a["1.weight"].fill(3e38), "an action of seed 0 is not finite"),
    "no deviation": (lambda a: a["log_std"].fill(1e4), "is invalid .*no deviation"),
    "less than no variance": (lambda a: a.update(statistics(-1.0)), "an action of seed 0 is not finite"),
}


def statistics(squares: float) -> dict[str, np.ndarray]:
    return {"num": np.ones(1), "mean": np.zeros((1, 2)), "squares": np.full((1, 2), squares)}


@pytest.fixture
def policies(tmp_path: Path) -> Path:
    """A run with one policy, of two layers."""
    arrays = {"0.weight": np.ones((1, 2, 2), np.float32), "1.weight": np.ones((1, 1, 2), np.float32)}
    arrays |= {"0.bias": np.zeros((1, 2), np.float32), "1.bias": np.ones((1, 1), np.float32)}
    about = {"task": "cartpole", "env_id": "planspace/CartPole-v0", "obs": "raw", "z": "none", "z_to": "both"}
    about |= {"seeds": [0], "returns": [1.0], "layer_norm": False, "columns": [0, 2], "num_obs": 2}
    about |= {"action_low": [-1.0], "action_high": [1.0], "embeddings": []}
    run = tmp_path / "run"
    run.mkdir()
    save_policies(run, {**arrays, "log_std": np.zeros((1, 1), np.float32)}, about)
    load_policy(run)
    return run


@pytest.mark.usefixtures("canary")
@pytest.mark.parametrize("trick", POLICIES)
def test_policies_that_lie(trick: str, policies: Path) -> None:
    change, message = POLICIES[trick]
    reseal(policies / "policies.json", change)
    assert_refused(policies, lambda: load_policy(policies), message)


@pytest.mark.parametrize("trick", POLICY_WEIGHTS)
def test_policies_that_do_not_compute(trick: str, policies: Path) -> None:
    change, message = POLICY_WEIGHTS[trick]
    arrays = {name: array.copy() for name, array in read_arrays(policies / "policies.safetensors").items()}
    change(arrays)
    write_arrays(policies / "policies.safetensors", arrays)
    reseal(policies / "policies.json", lambda text: None)
    assert_refused(policies, lambda: load_policy(policies), message)


@pytest.mark.usefixtures("canary")
def test_a_policy_plays_in_its_tasks_environment_whatever_it_names(policies: Path) -> None:
    policy = load_policy(policies)
    policy.about["env_id"] = f"{CANARY}:planspace/CartPole-v0"
    with nothing_else_happens(policies):
        env = make_env(policy)
    assert env.spec is not None and env.spec.id == "planspace/CartPole-v0"


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
    "a shard twice": lambda t: t["shards"].append(first_shard(t)),
    "shards that are no list": lambda t: t.update(shards={}),
    "a beginning before the first": lambda t: t.update(next_index=-1),
    "a text for names": lambda t: t["info"].update(names="abcd"),
    "less than no controls": lambda t: t["info"].update(num_controls=-1),
    "a rotation that is cut off": lambda t: t["info"].update(quaternion_columns=[2]),
    "a text for a flag": lambda t: t["info"].update(kinematic="no"),
}


@pytest.fixture
def dataset(demos: Demos, tmp_path: Path) -> Path:
    folder = DemoFolder(tmp_path / "d", demos.info, {"seed": 0})
    folder.append([demos.episode(i) for i in range(3)], next_index=3)
    return tmp_path / "d"


@pytest.mark.parametrize("trick", MANIFESTS)
def test_manifests_that_lie(trick: str, dataset: Path, tmp_path: Path) -> None:
    reseal(dataset / "manifest.json", MANIFESTS[trick])
    assert_refused(dataset, lambda: load_demos(dataset), "is invalid")


SHARDS: dict[str, Change] = {
    "diverged": lambda a: set_diverged(a["states"]),
    "offsets that turn back": lambda a: a.update(offsets=a["offsets"][::-1].copy()),
    "no controls": lambda a: a.pop("controls"),
    "texts for numbers": lambda a: a.update(times=a["times"].astype(np.uint8)),
}


@pytest.mark.parametrize("trick", SHARDS)
def test_shards_that_lie(trick: str, dataset: Path, tmp_path: Path) -> None:
    file = dataset / "shard-00000.safetensors"
    arrays = {name: array.copy() for name, array in read_arrays(file).items()}
    SHARDS[trick](arrays)
    write_arrays(file, arrays)
    reseal(dataset / "manifest.json", lambda text: first_shard(text).update(sha256=file_hash(file)))
    assert_refused(dataset, lambda: load_demos(dataset), r"shard-00000.safetensors .*is invalid")


@pytest.mark.parametrize(
    "text",
    [b"[" * 200_000, DEEP, b'{"schema": ' + b"9" * 50_000 + b"}\n", b"\xff\xfe{}", b"[]\n", b"", b"NaN\n"],
    ids=["deep list", "deep", "digits", "no text", "list", "empty", "NaN"],
)
def test_json_that_is_none(text: bytes, dataset: Path, tmp_path: Path) -> None:
    (dataset / "manifest.json").write_bytes(text)
    assert_refused(dataset, lambda: load_demos(dataset), "manifest.json was altered or damaged")


def test_archives_with_objects_in_them(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "sprung",))

    given, objects = tmp_path / "given", np.array([Bomb()], dtype=object)
    given.mkdir()
    np.savez(given / "bomb.npz", states=objects, controls=objects, offsets=objects)

    def read() -> None:
        import_demos([str(given / "bomb.npz")], given / "out", None, ImportOptions())

    assert_refused(given, read, r"bomb\.npz")
    assert not (tmp_path / "sprung").exists() and not (given / "out" / "manifest.json").exists()


LONG_CELLS = {"text": "x" * 4000, "list": [0] * 4000, "object": {"x" * 4000: [[0]] * 4000}}


@pytest.mark.parametrize("cell", LONG_CELLS.values(), ids=LONG_CELLS)
def test_a_cell_of_any_length_is_quoted_in_part(cell: Any, tmp_path: Path) -> None:
    (tmp_path / "plan_0.json").write_text(json.dumps({"state_dims": ["x"], "path": [[0], [cell]]}))
    with pytest.raises(PlanspaceError, match="row 1 of path contains .* not a finite number") as caught:
        import_demos([str(tmp_path / "plan_0.json")], tmp_path / "out", None, ImportOptions())
    assert len(str(caught.value)) < 300 + len(str(tmp_path))


# --- models ----------------------------------------------------------------------------------------------

BODY = '<body><joint/><geom size="1"/></body>'
HINGE = '<body><joint name="j"/><geom size="1"/></body>'
NESTED = '<replicate count="1000">' * 4 + BODY + "</replicate>" * 4
DEEP_BODIES = "<body>" * 10_000 + "</body>" * 10_000
FLEX = '<flexcomp name="f" type="grid" count="900 900 900" spacing="1 1 1"/>'
CONTACT = '<contact num="200000"/>'
LARGE = '<mesh file="large.obj"/>'
TABLE, PAST = '<numeric name="n" size="900000"/>', '<jointpos nsample="900000"/>'
MADE = '<mesh builtin="supertorus" params="250 0.5 1 1"/>'
PICTURE = '<texture type="2d" builtin="flat" width="8192" height="8192"/>'
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
    "copies of copies": (f"<worldbody>{NESTED}</worldbody>", "parts, multiplied"),
    "a body of points": (f"<worldbody>{FLEX}</worldbody>", "points of flexible"),
    "infinitely many": ('<worldbody><replicate count="inf"/></worldbody>', "too much"),
    "deep": (f"<worldbody>{DEEP_BODIES}</worldbody>", "deep"),
    "a picture of any size": (
        '<asset><texture builtin="flat" width="900000" height="900000"/></asset>',
        "cells",
    ),
    "a field of any size": ('<asset><hfield name="h" nrow="900000" ncol="900000"/></asset>', "cells"),
    "any memory": ('<size memory="900T"/>', "reserves more"),
    "any stack": ('<size nstack="9000000000000"/>', "reserves more"),
    "any size": ('<size nuserdata="2000000000"/>', "too much"),
    "two sizes": (f'<size nuserdata="900000"/><custom>{TABLE}</custom>', "numbers"),
    "a size of every part": (f'<size nuser_geom="90000"/><worldbody>{20 * "<geom/>"}</worldbody>', "numbers"),
    "a table of any size": (f"<custom>{2 * TABLE}</custom>", "numbers"),
    "contacts without end": ('<sensor><contact num="500000000"/></sensor>', "too much"),
    "many sensors of many": (f"<sensor>{9 * CONTACT}</sensor>", "numbers"),
    "an activation of any size": ('<actuator><general actdim="500000000"/></actuator>', "too much"),
    "a past of any length": (f"<sensor>{2 * PAST}</sensor>", "numbers"),
    "a camera of any size": ('<worldbody><camera resolution="30000 30000"/></worldbody>', "cells"),
    "many pictures": (f"<asset>{20 * PICTURE}</asset>", "cells"),
    "a mesh of any size": ('<asset><mesh builtin="plate" params="5000 5000"/></asset>', "cells"),
    "a flexible body that takes long": (
        '<worldbody><flexcomp count="30 30 30"/></worldbody>',
        "points of flexible",
    ),
    "flexible bodies by default": (f"<worldbody>{6 * '<flexcomp/>'}</worldbody>", "points of flexible"),
    "a flexible body of cells": (
        '<worldbody><flexcomp count="2 2 2" cellcount="100 100 100"/></worldbody>',
        "points of flexible",
    ),
    "a long chain": ('<worldbody><composite count="3000 1 1"/></worldbody>', "links"),
    "many copies": (f'<worldbody><replicate count="9000">{BODY}</replicate></worldbody>', "multiplied"),
    "many meshes": (f"<asset>{9 * MADE}</asset>", "cells"),
    "a cube's sides": ('<asset><texture builtin="flat" width="8192"/></asset>', "cells"),
    "pictures by default": (
        f'<default><texture width="8192" height="8192"/></default><asset>{2 * "<texture/>"}</asset>',
        "cells",
    ),
    "a screen of any size": ('<visual><global offwidth="90000" offheight="90000"/></visual>', "cells"),
    "shadows of any size": ('<visual><quality shadowsize="90000"/></visual>', "cells"),
    "activations by default": (
        f'<default><general actdim="9000"/></default><actuator>{200 * "<motor/>"}</actuator>',
        "numbers",
    ),
    "a distance for each pixel": (
        '<worldbody><camera name="c" resolution="2000 2000"/></worldbody>'
        '<sensor><rangefinder camera="c"/></sensor>',
        "numbers",
    ),
    "a user's numbers for every part": (
        f'<worldbody><replicate count="2000"><geom user="{"1 " * 900}"/></replicate></worldbody>',
        "numbers",
    ),
    "keys without end": ('<size nkey="1000000"/>', "nkey"),
    "constraints without end": ('<size njmax="1000000"/>', "njmax"),
    "a size of tomorrow": ('<worldbody><body numshadows="2000000000"/></worldbody>', "too much"),
    "counts in parts": (
        '<worldbody><replicate count="90"><include file="part.xml"/></replicate></worldbody>',
        "multiplied",
    ),
    "sizes in parts": (f'<include file="part.xml"/><sensor>{4 * CONTACT}</sensor>', "numbers"),
    "steps without end": ('<option ls_iterations="1000000000"/>', "iterations"),
    "lengths that are looked for without end": (
        '<compiler><lengthrange inttotal="1e9"/></compiler>',
        "a lengthrange of more than",
    ),
    "a step that is no number": ('<option timestep="nan"/>', "where a number belongs"),
    "a step backwards": ('<option timestep="-0.01"/>', "a time step is at least"),
    "no step": ('<option timestep="0"/>', "a time step is at least"),
    "a step of a day": ('<option timestep="86400"/>', "timestep='86400'; a time step is .* at most 1 s"),
    "hardly a step": ('<option timestep="1e-300"/>', "a time step is at least 1e-06 s"),
    "stl of 10^9 faces": ('<asset><mesh file="faces.stl"/></asset>', "its header asks for"),
    "msh of 10^9 points": ('<asset><mesh file="points.msh"/></asset>', "its header asks for"),
    "a mesh that is a pipe": ('<asset><mesh file="pipe.stl"/></asset>', "not a regular file"),
    "files of many pixels": (
        f'<asset>{2 * """<texture type="2d" file="wide.png"/>"""}</asset>',
        "pictures of 72000000 pixels",
    ),
    "a file many times": (f"<asset>{5 * LARGE}</asset>", "files of 3145728.0 bytes"),
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
    os.mkfifo(folder / "pipe.stl")
    (folder / "loop.xml").write_text('<mujoco><include file="loop.xml"/></mujoco>')
    (folder / "part.xml").write_text(
        f'<mujoco><worldbody><replicate count="90">{BODY}</replicate></worldbody>'
        f"<sensor>{2 * CONTACT}</sensor></mujoco>"
    )
    (folder / "faces.stl").write_bytes(bytes(80) + struct.pack("<I", 10**9))
    (folder / "points.msh").write_bytes(struct.pack("<4i", 10**9, 0, 0, 0))
    for name, side in (("pixels", 10**6), ("wide", 6000)):
        picture = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4s2I", 13, b"IHDR", side, side)
        (folder / f"{name}.png").write_bytes(picture)
    with open(folder / "large.obj", "wb") as file:
        file.truncate(60 << 20)
    return folder


@pytest.mark.parametrize("trick", MODELS)
def test_models_that_reach_out_or_ask_for_too_much(trick: str, models: Path, tmp_path: Path) -> None:
    inside, message = MODELS[trick]
    (models / "model.xml").write_text(f"<mujoco>{inside}</mujoco>")
    assert_refused(models, lambda: read_model(models / "model.xml"), message)


def test_robots_ask_for_less() -> None:
    assets = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
    files = sorted(assets.glob("*.xml"))
    assert len(files) > 10
    for file in files:
        parse_model(file.read_text(), str(file))


@pytest.mark.parametrize("text", [BOMB, OUTSIDE], ids=["bomb", "outside"])
def test_entities(text: str, models: Path, tmp_path: Path) -> None:
    (models / "model.xml").write_text(text)
    assert_refused(models, lambda: read_model(models / "model.xml"), "entities")


@pytest.mark.parametrize(
    "inside", ['<include file="/etc/passwd"/>', '<asset><mesh file="/etc/m.stl"/></asset>']
)
def test_the_model_in_a_dataset_reaches_out(inside: str, dataset: Path, tmp_path: Path) -> None:
    model = f"<mujoco>{inside}</mujoco>"
    reseal(dataset / "manifest.json", lambda text: text["info"].update(mjcf=model))
    assert_refused(dataset, lambda: validate(dataset, replay_controls=True), "refers to the file '/etc/")


def test_a_model_of_strangers_is_compiled_apart(models: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = f"<mujoco>{{}}<worldbody>{BODY}</worldbody></mujoco>"
    check_compiles(text.format(""))
    (models / "model.xml").write_text(text.format(""))
    assert apart.read_model_in_subprocess(models / "model.xml") == text.format("")
    with pytest.raises(PlanspaceError, match="does not compile: .*nonsense"):
        check_compiles("<mujoco><nonsense/></mujoco>")
    with pytest.raises(UsageError, match="unknown joint 'x'"):
        apart.read_model_in_subprocess(models / "model.xml", ["x"])
    greedy = text.format('<size memory="1000M"/>')
    check_compiles(greedy)
    monkeypatch.setattr(apart, "MEMORY_BYTES", 1 << 30)
    with pytest.raises(PlanspaceError, match="does not compile: .*Could not allocate memory"):
        check_compiles(greedy)
    monkeypatch.setattr(apart, "WALL_S", 0.01)
    with pytest.raises(PlanspaceError, match="does not compile within .* 1 GiB of memory"):
        check_compiles(text.format(""))


@pytest.mark.parametrize("words", ["plan", "demos import"])
def test_a_problem_of_strangers_ends_in_one_line(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("model.xml").write_text(f'<mujoco><size memory="1000M"/><worldbody>{HINGE}</worldbody></mujoco>')
    Path("problem.yaml").write_text("model: model.xml\njoints: [j]\nstart: [0]\ngoal: [0]\ntolerance: 0.1\n")
    Path("demos.csv").write_text("time,x\n0,1\n0.1,2\n")
    monkeypatch.setattr(apart, "MEMORY_BYTES", 1 << 30)
    line = "plan problem.yaml" if words == "plan" else "demos import demos.csv --problem problem.yaml"
    assert main([*line.split(), "--untrusted", "--out", "out"]) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("planspace: ") and "Could not allocate memory" in said
    assert not Path("out").exists()


def test_a_model_that_crashes_mujoco_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "python").write_text("#!/bin/sh\nkill -SEGV $$\n")
    (tmp_path / "python").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    with pytest.raises(PlanspaceError, match="does not compile within .* or crashes MuJoCo"):
        check_compiles("<mujoco/>")


def test_a_model_that_takes_all_day_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(apart, "CPU_S", 2)
    crowd = '<replicate count="4900" offset="1 0 0"><geom name="g" size="0.1"/></replicate>'  # 5 s
    with pytest.raises(PlanspaceError, match="does not compile within 2 s of one processor"):
        check_compiles(f"<mujoco><worldbody>{crowd}</worldbody></mujoco>")


# --- problems --------------------------------------------------------------------------------------------

ALIASES = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
YAML = {
    "code": ("model: !!python/object/apply:os.system ['touch sprung']\n", "not valid YAML"),
    "a tag": ("model: !!python/name:os.system\n", "not valid YAML"),
    "aliases of aliases": (ALIASES, "unknown key"),
    "aliases in a value": ("joints: &a [*a]\n", "not valid YAML|missing|is invalid|joints"),
    "deep": ("a: " + "[" * 100_000, "not valid YAML"),
    "large": ("# " + "x" * (1 << 20), "at most"),
    "more keys than a second reads": ("".join(f"k{i}: 1\n" for i in range(20_000)), "at most"),
    "a key twice": ("model: a\nmodel: b\n", "comes twice"),
    "keys of another mapping": ("a: &a {b: 1}\nc: {<<: *a}\n", "must be plain text"),
    "a list for a key": ("? [a]\n: 1\n", "must be plain text"),
    "a number for a key": ("1: 2\n", "must have names as keys"),
    "a number with colons without end": (
        "a: 1" + ":1" * 60_000,
        "a text has 120001 characters; the limit is 4096",
    ),
    "a model elsewhere": (
        "model: ../secret.xml\njoints: [a]\nstart: [0]\ngoal: [0]\ntolerance: 1\n",
        "outside its folder",
    ),
}


@pytest.mark.parametrize("trick", YAML)
def test_problems_that_do_harm(trick: str, models: Path, tmp_path: Path) -> None:
    text, message = YAML[trick]
    (models / "p.yaml").write_text(text)
    assert_refused(models, lambda: load_problem(str(models / "p.yaml")), message)
    assert not list(tmp_path.rglob("sprung"))


def test_names_stay_text_in_a_page_of_paths(embedding: Embedding, demos: Demos) -> None:
    from dataclasses import replace

    from planspace.figures.interactive_paths import paths_html
    from planspace.figures.paths import embedded_paths

    evil = "</script><script>alert(1)</script>"
    names = (evil, *demos.info.names[1:])
    inputs = replace(embedding.inputs, names=names)
    shown = replace(demos, info=replace(demos.info, names=names, problem=evil))
    page = paths_html(embedded_paths(replace(embedding, inputs=inputs), shown, np.arange(3)))
    assert evil not in page


def test_there_are_forty() -> None:
    corpus = (SAFETENSORS, WEIGHTS, DESCRIPTIONS, POLICIES, POLICY_WEIGHTS, MANIFESTS, SHARDS, MODELS, YAML)
    assert sum(map(len, corpus)) >= 40
