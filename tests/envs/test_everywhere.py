"""Every task, bare and wrapped, in the checkers and vector environments of Gymnasium and SB3."""

import copy
import pickle
import warnings
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.envs.wrappers import PlanSpaceObservation, PlanSpaceShaping
from planspace.tasks.catalog import TASKS
from planspace.tasks.task import Task

NAMED_WARNINGS = (
    "symmetric and normalized",  # both checkers, of an action range other than -1 to 1
    "minimum value is -infinity",  # Gymnasium's, of unbounded observations
    "maximum value is infinity",
    "is different from the unwrapped version",  # Gymnasium's, of anything wrapped
)
KINDS = ("bare", "augment", "replace", "dict", "shaping")
Maker = Callable[..., gymnasium.Env]


@pytest.fixture(scope="module")
def embeddings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """An embedding with random weights for every task."""
    folder, rng = tmp_path_factory.mktemp("embeddings"), np.random.default_rng(0)
    for task in TASKS.values():
        space = task.compile()[1]
        inputs = Inputs.fit(rng.normal(size=(9, space.size)), space.names, space.units, (), "raw")
        encoder = ([rng.normal(size=(6, space.size))], [np.zeros(6)])
        decoder = ([rng.normal(size=(2 * space.size, 3))], [np.zeros(2 * space.size)])
        Embedding(inputs, encoder, decoder, 0.0).save(folder / task.name)
    return {name: folder / name for name in TASKS}


@pytest.fixture
def make(embeddings: dict[str, Path]) -> Maker:
    def make(task: Task, kind: str) -> gymnasium.Env:
        env = gymnasium.make(task.env_id)
        if kind == "bare":
            return env
        if kind == "shaping":
            goal = np.zeros(task.compile()[1].size).tolist()
            return PlanSpaceShaping(env, embeddings[task.name], goal=goal)
        return PlanSpaceObservation(env, embeddings[task.name], kind)

    return make


def every(*kinds: str) -> pytest.MarkDecorator:
    cases = [pytest.param(t, k, id=f"{t.name}-{k}") for t in TASKS.values() for k in kinds]
    return pytest.mark.parametrize(("task", "kind"), cases)


def strange_warnings(check: Callable[..., None], env: gymnasium.Env) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check(env, skip_render_check=True)
    return [str(w.message) for w in caught if not any(name in str(w.message) for name in NAMED_WARNINGS)]


@every(*KINDS)
def test_gymnasiums_checker_passes(make: Maker, task: Task, kind: str) -> None:
    assert strange_warnings(check_env, make(task, kind)) == []


@every(*KINDS)
def test_sb3s_checker_passes(make: Maker, task: Task, kind: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra sb3")
    assert strange_warnings(checker.check_env, make(task, kind)) == []


@every(*KINDS)
def test_copies_and_specs_are_the_same_environment(make: Maker, task: Task, kind: str) -> None:
    env = make(task, kind)
    assert env.spec is not None
    spec = type(env.spec).from_json(env.spec.to_json())
    others = gymnasium.make(spec), pickle.loads(pickle.dumps(env)), copy.deepcopy(env)
    env.action_space.seed(0)
    action = env.action_space.sample()
    env.reset(seed=5)
    wanted = env.step(action)
    for other in others:
        other.reset(seed=5)
        got = other.step(action)
        assert gymnasium.utils.env_checker.data_equivalence(got[0], wanted[0])
        assert got[1:4] == wanted[1:4]


@pytest.mark.slow
@every("augment")
def test_gymnasiums_vector_environments_work_with_the_spec(make: Maker, task: Task, kind: str) -> None:
    spec = make(task, kind).spec
    assert spec is not None
    sync = gymnasium.make_vec(spec, num_envs=2, vectorization_mode="sync")
    spawned = gymnasium.make_vec(
        spec, num_envs=2, vectorization_mode="async", vector_kwargs={"context": "spawn"}
    )
    try:
        assert np.array_equal(sync.reset(seed=1)[0], spawned.reset(seed=1)[0])
        sync.action_space.seed(0)
        for _ in range(3):
            actions = sync.action_space.sample()
            for a, b in zip(sync.step(actions)[:4], spawned.step(actions)[:4], strict=True):
                assert np.array_equal(a, b)
    finally:
        spawned.close()
