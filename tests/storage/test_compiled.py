import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import pytest

from planspace.storage.compiled import MAX_AGE_S, use_compilation_cache

pytestmark = pytest.mark.skipif(os.name == "nt", reason="nothing is kept on Windows")

TRAIN = """
import sys
import jax
from planspace.cli import main

taken = []
jax.monitoring.register_event_listener(lambda name, **_: taken.append(name.endswith("/cache_hits")))
code = main(["train", "cartpole-swingup", "--steps", "4000", "--seeds", "1", "--out", sys.argv[1]])
print("taken", sum(taken))
raise SystemExit(code)
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A user's cache folder, and JAX as it comes: without a cache."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    jax.config.update("jax_compilation_cache_dir", None)
    yield tmp_path / "cache"
    for name, value in before.items():
        jax.config.update(name, value)


def kept_in() -> Path | None:
    """Where programs are kept from now on."""
    use_compilation_cache()
    chosen = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    return None if chosen is None else Path(chosen)


def train(out: Path, **environment: str) -> tuple[int, bytes, str]:
    """How many programs a training took, the history it ended with, and what it said."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    command = [sys.executable, "-c", TRAIN, str(out)]
    done = subprocess.run(
        command, env=kept | environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    taken = int(done.stdout.split()[-1])
    return taken, (out / "history.safetensors").read_bytes(), done.stderr


def test_the_next_start_takes_what_was_compiled_and_ends_the_same(cache: Path, tmp_path: Path) -> None:
    home = {"XDG_CACHE_HOME": str(cache)}
    taken, history, _ = train(tmp_path / "compiled", **home)
    assert taken == 0
    kept = list(cache.glob("planspace/*/*-cache"))
    assert kept
    taken, again, _ = train(tmp_path / "taken", **home)
    assert taken >= 1 and again == history
    for file in kept:
        file.write_bytes(file.read_bytes()[:1000])  # a crash cut it off
    _, again, said = train(tmp_path / "cut off", **home)
    assert again == history and "Error" not in said
    taken, again, _ = train(tmp_path / "off", JAX_ENABLE_COMPILATION_CACHE="false", **home)
    assert taken == 0 and again == history


def test_every_number_of_threads_has_its_own(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = kept_in()
    assert folder is not None and folder.is_dir() and folder.is_relative_to(cache)
    monkeypatch.setenv("NPROC", "3")
    assert kept_in() not in (None, folder)


@pytest.mark.parametrize("part", ["planspace", "machine"])
def test_nothing_is_taken_from_where_others_write(part: str, cache: Path, tmp_path: Path) -> None:
    folder = kept_in()
    assert folder is not None and folder.stat().st_mode & 0o777 == 0o700
    mine = folder if part == "machine" else folder.parent
    mine.chmod(0o775)
    assert kept_in() is None
    mine.rename(tmp_path / "elsewhere")
    mine.symlink_to(tmp_path / "elsewhere")
    assert kept_in() is None


def test_old_programs_are_removed(cache: Path) -> None:
    folder = kept_in()
    assert folder is not None
    for name, age in (("old-cache", MAX_AGE_S + 60), ("new-cache", MAX_AGE_S - 60)):
        (folder / name).write_bytes(b"")
        os.utime(folder / name, (time.time() - age, time.time() - age))
    kept_in()
    assert [file.name for file in folder.iterdir()] == ["new-cache"]


def test_a_user_keeps_his_own_cache(cache: Path) -> None:
    jax.config.update("jax_compilation_cache_dir", str(cache / "his"))
    use_compilation_cache()
    assert jax.config.jax_compilation_cache_dir == str(cache / "his") and not cache.exists()


def test_without_a_home_nothing_is_kept(cache: Path) -> None:
    cache.write_text("no folder")
    assert kept_in() is None
