import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import pytest

from planspace.storage.compiled import MAX_AGE_S, use_compilation_cache

pytestmark = pytest.mark.skipif(os.name == "nt", reason="there is no cache on Windows")

TRAIN = """
import sys
import jax
from planspace.cli import main

hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name.endswith("/cache_hits")))
code = main(["train", "cartpole-swingup", "--steps", "4000", "--seeds", "1", "--out", sys.argv[1]])
print("hits", sum(hits))
raise SystemExit(code)
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A user's cache folder, and JAX in its default state: without a cache."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    jax.config.update("jax_compilation_cache_dir", None)
    yield tmp_path / "cache"
    for name, value in before.items():
        jax.config.update(name, value)


def cache_folder() -> Path | None:
    """The folder where programs are stored from now on."""
    use_compilation_cache()
    chosen = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    return None if chosen is None else Path(chosen)


def train(out: Path, **environment: str) -> tuple[int, bytes, str]:
    """Train in a subprocess; returns the number of cache hits, the history file and standard error."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    command = [sys.executable, "-c", TRAIN, str(out)]
    done = subprocess.run(
        command, env=inherited | environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    hits = int(done.stdout.split()[-1])
    return hits, (out / "history.safetensors").read_bytes(), done.stderr


@pytest.mark.nightly
def test_the_next_start_loads_compiled_programs_and_ends_the_same(cache: Path, tmp_path: Path) -> None:
    home = {"XDG_CACHE_HOME": str(cache)}
    hits, history, _ = train(tmp_path / "compiled", **home)
    assert hits == 0
    programs = list(cache.glob("planspace/*/*-cache"))
    assert programs
    hits, again, _ = train(tmp_path / "loaded", **home)
    assert hits >= 1 and again == history
    for file in programs:
        file.write_bytes(file.read_bytes()[:1000])  # as after a crash
    _, again, stderr = train(tmp_path / "truncated", **home)
    assert again == history and "Error" not in stderr
    hits, again, _ = train(tmp_path / "off", JAX_ENABLE_COMPILATION_CACHE="false", **home)
    assert hits == 0 and again == history


def test_each_number_of_threads_has_its_own_folder(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = cache_folder()
    assert folder is not None and folder.is_dir() and folder.is_relative_to(cache)
    monkeypatch.setenv("NPROC", "3")
    assert cache_folder() not in (None, folder)


@pytest.mark.parametrize("part", ["planspace", "machine"])
def test_a_folder_that_others_can_write_is_not_used(part: str, cache: Path, tmp_path: Path) -> None:
    folder = cache_folder()
    assert folder is not None and folder.stat().st_mode & 0o777 == 0o700
    mine = folder if part == "machine" else folder.parent
    mine.chmod(0o775)
    assert cache_folder() is None
    mine.rename(tmp_path / "elsewhere")
    mine.symlink_to(tmp_path / "elsewhere")
    assert cache_folder() is None


def test_old_programs_are_removed(cache: Path) -> None:
    folder = cache_folder()
    assert folder is not None
    for name, age in (("old-cache", MAX_AGE_S + 60), ("new-cache", MAX_AGE_S - 60)):
        (folder / name).write_bytes(b"")
        os.utime(folder / name, (time.time() - age, time.time() - age))
    cache_folder()
    assert [file.name for file in folder.iterdir()] == ["new-cache"]


def test_the_users_own_cache_is_kept(cache: Path) -> None:
    jax.config.update("jax_compilation_cache_dir", str(cache / "own"))
    use_compilation_cache()
    assert jax.config.jax_compilation_cache_dir == str(cache / "own") and not cache.exists()


def test_without_a_cache_folder_nothing_is_stored(cache: Path) -> None:
    cache.write_text("not a folder")
    assert cache_folder() is None
