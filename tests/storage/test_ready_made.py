"""Ready-made artefacts: they load by name, and no file was changed."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import planspace as ps
from planspace.cli import main
from planspace.errors import UsageError
from planspace.storage.ready_made import EMBEDDING, HASHES, PLANS, POLICY, READY, find_folder, ready_names

NAMES = ready_names(EMBEDDING)


def test_every_file_has_the_listed_hash_and_all_are_small() -> None:
    listed = dict(line.split("  ")[::-1] for line in HASHES.read_text().splitlines())
    files = [file for file in READY.rglob("*") if file.is_file() and file != HASHES]
    found = {f.relative_to(READY).as_posix(): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}
    assert found == listed and ready_names(PLANS) == NAMES
    assert sum(file.stat().st_size for file in files) < 2.5 * 2**20
    assert all((READY / name / EMBEDDING / "README.md").is_file() for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_an_artefact_loads_and_its_embedding_fits_its_plans(name: str) -> None:
    demos, embedding = ps.load_demos(name), ps.load_embedding(name)
    about = embedding.require_about()
    assert about.problem == demos.info.problem
    assert demos.success.all() and embedding.outside_support(demos.states).mean() < 0.1
    assert about.metrics["test"]["time_correlation"] > 0.9
    if embedding.time_head is not None:
        learned = about.settings.demos == demos.hash  # otherwise it has seen none of the plans
        plan = demos.episode(int(about.split["test"][0]) if learned else 0)
        to_go = embedding.time_to_go(plan.states, np.broadcast_to(plan.states[-1], plan.states.shape))
        assert np.corrcoef(to_go, plan.times[-1] - plan.times)[0, 1] > 0.8


def test_a_policy_plays_better_than_idling(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["play", "cartpole-swingup", "--episodes", "3"]) == 0
    mean = float(capsys.readouterr().out.split("mean ")[1].split(",")[0])
    assert mean > -200  # idling earns -600
    assert ps.load_policy("cartpole-swingup").embedding.parent == READY / "cartpole-swingup" / POLICY


def test_names_are_offered_and_folders_win(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_folder("reacher", EMBEDDING) == READY / "reacher" / EMBEDDING
    ps.load_embedding("pendulum-swingup").save("reacher")
    assert ps.load_embedding("reacher").hash == ps.load_embedding("pendulum-swingup").hash
    assert ps.load_embedding(READY / "reacher" / EMBEDDING).hash != ps.load_embedding("pendulum-swingup").hash
    message = r"there is no folder 'cartpole-swngup' and no .* Did you mean 'cartpole-swingup'\? Ready-made "
    for load in (ps.load_embedding, ps.load_demos, ps.load_policy):
        with pytest.raises(UsageError, match=message):
            load("cartpole-swngup")
    with pytest.raises(ps.PlanspaceError, match=r"^no/reacher is not an embedding"):
        ps.load_embedding("no/reacher")


def test_loading_by_name_imports_neither_jax_nor_mujoco() -> None:
    code = "import sys, planspace; planspace.load_embedding('cartpole-swingup').encode([0.0] * 4); "
    code += "print([m for m in ('jax', 'mujoco', 'huggingface_hub') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        "measure cartpole-swingup cartpole-swingup --plot drawn",
        "demos show cartpole-swingup",
        "demos validate cartpole-swingup --replay",
        "control cartpole-swingup --embedding cartpole-swingup --episodes 1 --episode-s 0.4 --no-film"
        " --out controlled",
        "train pendulum-swingup --z augment --embedding pendulum-swingup --plans pendulum-swingup"
        " --resets 0.5 --steps 400 --batch-steps 200 --seeds 1 --out run",
    ],
)
def test_commands_take_names(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(command.split()) == 0
