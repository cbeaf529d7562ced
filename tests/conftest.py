"""Fixtures: small real artefacts, made once a session."""

import os
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.embed.config import PRESETS
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.plan.config import PlanConfig, PolishConfig
from planspace.plan.demonstrations import plan_into
from planspace.plan.sst import SST
from planspace.tasks.problem_file import load_problem

RELEASED = Path(__file__).parents[2] / "shared" / "data" / "released-2020"

QUICK_PLANNER = PlanConfig(SST(extensions=256), restarts=1, polish=PolishConfig(max_iterations=15))
QUICK_FIT = replace(PRESETS["modern"], steps=300, batch=64)

QUICK_COMPILER = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
"""The tests compile more than they compute; this takes a third off their processor time."""


def pytest_configure(config: pytest.Config) -> None:
    """Programs are compiled quickly, and kept between tests, subprocesses and runs."""
    assert config.cache is not None
    os.environ.setdefault("XLA_FLAGS", QUICK_COMPILER)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(config.cache.mkdir("jax"))
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.3"
    jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


@pytest.fixture(scope="session")
def released() -> Path:
    """The demonstrations released in 2020; a developer has them beside the checkout, a user does not."""
    if not RELEASED.exists():
        pytest.skip("the released demonstrations are not beside this checkout")
    return RELEASED


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve planned swing-ups."""
    out = tmp_path_factory.mktemp("demos") / "demos"
    plan_into(load_problem("cartpole-swingup"), out, num=12, seed=0, config=QUICK_PLANNER)
    return out


@pytest.fixture(scope="session")
def demos(demo_folder: Path) -> Demos:
    return load_demos(demo_folder)


@pytest.fixture(scope="session")
def embedding_folder(demos: Demos, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An embedding of those, trained briefly, two seeds."""
    out = tmp_path_factory.mktemp("embedding") / "embedding"
    fit_embedding(demos, out=out, config=QUICK_FIT, num_seeds=2)
    return out


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a tiny study that has been run."""
    from planspace.study.run import run_study

    from .tiny_study import TINY

    out = tmp_path_factory.mktemp("study") / "out"
    assert run_study(TINY, out, workers=2) == {}
    return out


@pytest.fixture
def embedding(embedding_folder: Path) -> Embedding:
    from planspace import load_embedding

    return load_embedding(embedding_folder)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def opengl() -> str:
    """A backend that works on this machine."""
    from planspace.physics.rendering import rendering_backend

    backend = rendering_backend()
    if backend is None:
        pytest.skip("no OpenGL backend works here")
    return backend


@pytest.fixture
def benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scripts in benchmarks/ can be imported."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
