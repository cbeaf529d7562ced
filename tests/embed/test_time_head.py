"""The time head: a quasimetric in seconds, its training, and its place in the artefact."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import planspace as ps
from planspace.cli import main
from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.search_tree import SearchTree
from planspace.demos.state_info import StateInfo
from planspace.embed import time_head, time_training
from planspace.embed.config import FitConfig, TimeHeadConfig
from planspace.embed.embedding import Embedding
from planspace.embed.networks import glorot_layers
from planspace.embed.time_head import TimeHead
from planspace.embed.time_training import Head, fit_time_head, make_pairs
from planspace.errors import PlanspaceError, UsageError
from planspace.storage.arrays import read_arrays, write_arrays
from planspace.storage.json_files import read_sealed, write_sealed

from ..conftest import QUICK_FIT
from .random_encoder import random_encoder, random_states
from .test_embedding import NUMPY_TOLERANCE


def random_head(embedding: Embedding, reads: time_head.TimeInput) -> TimeHead:
    size = {"state": len(embedding.inputs.mean), "z": embedding.z_dim}
    size["both"] = size["state"] + size["z"]
    weights, biases = glorot_layers((size[reads], 16, 8), jr.key(3))
    return TimeHead(list(map(np.asarray, weights)), list(map(np.asarray, biases)), reads)


@pytest.fixture(params=time_head.TIME_INPUTS)
def timed(request: pytest.FixtureRequest) -> Embedding:
    embedding = random_encoder("trig", (1,))
    return replace(embedding, time_head=random_head(embedding, request.param))


def test_it_is_a_quasimetric(timed: Embedding) -> None:
    a, b, c = random_states(timed, 300).reshape(3, 100, 4)
    d = timed.time_to_go
    assert (d(a, b) >= 0).all() and d(a, b).max() > 0
    np.testing.assert_array_equal(d(a, a), 0.0)
    assert (d(a, c) <= d(a, b) + d(b, c) + 1e-5).all()
    assert np.abs(d(a, b) - d(b, a)).max() > 0.1
    assert d(a, b[0]).shape == (100,) and d(a[0], b[0]).shape == ()
    np.testing.assert_allclose(d(a[:, None], b[None])[3, 5], d(a[3], b[5]), rtol=1e-4, atol=1e-5)


def test_numpy_and_jax_compute_the_same(timed: Embedding) -> None:
    head = timed.time_head
    assert head is not None
    a, b = random_states(timed, 40).reshape(2, 20, 4)
    network = Head(list(map(jnp.asarray, head.weights)), list(map(jnp.asarray, head.biases)))

    def read(states: np.ndarray) -> np.ndarray:
        inputs, z = timed.inputs(states), timed.encode(states)
        return np.concatenate({"state": [inputs], "z": [z], "both": [inputs, z]}[head.reads], axis=-1)

    features = [jax.vmap(network)(jnp.asarray(read(x), dtype=jnp.float32)) for x in (a, b)]
    expected = jax.vmap(time_training.quasimetric)(*features)
    np.testing.assert_allclose(timed.time_to_go(a, b), expected, rtol=NUMPY_TOLERANCE, atol=NUMPY_TOLERANCE)


def test_quasimetric_by_hand() -> None:
    a, b = np.array([1.0, 5.0, 0.0]), np.array([3.0, 1.0, 0.5])  # b - a is (2, -4, 0.5)
    assert time_head.quasimetric(a, b) == 2.0
    assert time_head.quasimetric(b, a) == 4.0


def test_it_is_saved_in_the_artefact(timed: Embedding, tmp_path: Path) -> None:
    timed.save(tmp_path / "timed")
    loaded = ps.load_embedding(tmp_path / "timed")
    a, b = random_states(timed, 20).reshape(2, 10, 4)
    np.testing.assert_array_equal(loaded.time_to_go(a, b), timed.time_to_go(a, b))
    assert loaded.hash == timed.hash != replace(timed, time_head=None).hash
    assert "time to go" in repr(loaded)


def test_an_artefact_without_a_head_is_as_before_and_says_so(tmp_path: Path) -> None:
    embedding = random_encoder("trig", (1,))
    embedding.save(tmp_path / "plain")
    assert "time_head" not in read_sealed(tmp_path / "plain" / "embedding.json")
    state = random_states(embedding, 1)
    with pytest.raises(PlanspaceError, match="has no time head; train it with `planspace embed --time-head`"):
        ps.load_embedding(tmp_path / "plain").time_to_go(state, state)


def change_head(**changes: object) -> Callable[[dict, dict], None]:
    return lambda text, arrays: text["time_head"].update(changes)


BAD: dict[str, tuple[Callable[[dict, dict], None], str]] = {
    "unknown": (
        change_head(architecture="os.system"),
        "names the time head 'os.system'; .* only knows 'max-d",
    ),
    "input": (change_head(reads="pixels"), "malformed|not in tuple|pixels"),
    "none": (lambda t, a: [a.pop(k) for k in list(a) if "time_head" in k], "has no weights"),
    "nan": (
        lambda t, a: a["time_head.0.bias"].fill(np.nan),
        "time_head.0.bias contains a number that is not",
    ),
    "size": (lambda t, a: a.update({"time_head.0.weight": np.zeros((16, 99), np.float32)}), "embedding.json"),
    "null": (lambda t, a: t.update(time_head=None), "embedding.json"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_heads_are_refused(tmp_path: Path, name: str) -> None:
    embedding = random_encoder("trig", (1,))
    replace(embedding, time_head=random_head(embedding, "state")).save(tmp_path)
    text, arrays = read_sealed(tmp_path / "embedding.json"), read_arrays(tmp_path / "embedding.safetensors")
    change, message = BAD[name]
    change(text, arrays)
    text["weights_sha256"] = write_arrays(tmp_path / "embedding.safetensors", arrays)
    write_sealed(tmp_path / "embedding.json", text)
    with pytest.raises(PlanspaceError) as raised:
        ps.load_embedding(tmp_path)
    assert re.search(message, str(raised.value)) and "\n" not in str(raised.value), raised.value


# --- training -------------------------------------------------------------------------------------------
# A point that moves to the right at up to 1 m/s and to the left at up to 0.5 m/s: the shortest time from a to
# b is b - a if b > a, and 2 (a - b) otherwise.


def one_way_demos(rng: np.random.Generator, count: int = 10) -> Demos:
    info = StateInfo(("x", "y"), ("m", "m"), (), 1)
    times = np.linspace(0, 1, 21)
    episodes = []
    for i in range(count):
        states = np.stack([times - 0.5, np.sin(9 * times + i)], axis=1)
        parents, moves = [-1], [states[0, 0]]
        for node in range(1, 300):
            parents.append(int(rng.integers(0, node)))
            moves.append(moves[parents[-1]] + rng.choice([0.1, -0.05]))
        nodes = np.stack([moves, rng.uniform(-1, 1, 300)], axis=1)
        nodes[0] = states[0]
        tree = SearchTree(nodes, np.array(parents), np.array([0.0] + [0.1] * 299))
        controls = np.ones((20, 1))
        episodes.append(Episode(states, controls, times, states[-1], True, i, 0, tree=tree))
    return Demos.from_episodes(info, episodes)


@pytest.mark.slow
def test_training_finds_the_shortest_times_of_a_point_on_a_line() -> None:
    demos = one_way_demos(np.random.default_rng(0))
    embedding = ps.fit_embedding(demos, "pca", config=FitConfig(z_dim=2), verbose=False)
    config = TimeHeadConfig(hidden=(32,), features=16, steps=1000, batch=256)
    head = fit_time_head(embedding, demos, np.arange(10), config, seed=0)
    timed = replace(embedding, time_head=head)
    a, b = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 200, 2))
    b[:, 1] = a[:, 1]
    gap = b[:, 0] - a[:, 0]
    times = np.where(gap > 0, gap, -2 * gap)
    assert np.corrcoef(timed.time_to_go(a, b), times)[0, 1] > 0.95


def test_pairs_come_from_the_training_split_only() -> None:
    demos = one_way_demos(np.random.default_rng(0), 3)
    embedding = ps.fit_embedding(demos, "pca", config=FitConfig(z_dim=2), verbose=False)
    pairs = make_pairs(embedding, demos, np.array([0, 2]), TimeHeadConfig())
    assert pairs.x.shape == (2 * (21 + 300), 2)
    assert len(pairs.before) == 2 * (20 + 299)
    inverse = embedding.inputs.invert(np.asarray(pairs.x))
    np.testing.assert_allclose(inverse[42:342], demos.trees[0].states, atol=1e-5)
    np.testing.assert_allclose(inverse[342:], demos.trees[2].states, atol=1e-5)
    tree = demos.trees[2]
    np.testing.assert_array_equal(pairs.before[-299:], 342 + tree.parents[1:])
    np.testing.assert_array_equal(pairs.after[-299:], 342 + np.arange(1, 300))
    np.testing.assert_allclose(pairs.seconds[-299:], tree.durations[1:])
    without = make_pairs(embedding, replace(demos, trees=()), np.array([0, 2]), TimeHeadConfig())
    assert len(without.x) == 42 and len(without.before) == 40


@pytest.mark.slow
def test_the_rest_of_the_embedding_does_not_change(
    demos: Demos, embedding: Embedding, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = TimeHeadConfig(steps=50, batch=32)
    out, arguments = tmp_path / "timed", {"config": QUICK_FIT, "num_seeds": 2, "verbose": False}
    timed = ps.fit_embedding(demos, out=out, time_head=short, **arguments)
    assert replace(timed, time_head=None).hash == embedding.hash
    again = ps.fit_embedding(demos, out=out, time_head=short, **arguments)
    assert again.hash == timed.hash
    with pytest.raises(PlanspaceError, match=r"time_head"):
        ps.fit_embedding(demos, out=out, **arguments)
    demos.save(tmp_path / "demos")
    command = ["embed", str(tmp_path / "demos"), "--config", str(out / "config.json"), "--seeds", "2"]
    assert main([*command, "--out", str(tmp_path / "again")]) == 0
    assert ps.load_embedding(tmp_path / "again").hash == timed.hash
    assert main(["measure", str(out), str(tmp_path / "demos")]) == 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"steps": 0}, "`time_steps` must be at least 1, got 0"),
        ({"hidden": (0,)}, "`time_hidden` needs at least one unit in each layer, got (0,)"),
        ({"slack": 0.0}, "`time_slack` must be above 0 and finite, got 0.0"),
        ({"plan_weight": -1.0}, "`time_plan_weight` must be at least 0 and finite, got -1.0"),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict, message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        TimeHeadConfig(**wrong)
