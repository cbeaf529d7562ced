"""Make the ready-made artefacts that the package brings: plans, embeddings and policies of shipped tasks.

    python benchmarks/make_artefacts.py runs/artefacts

Plans, embeddings and policies are made in the folder, with the defaults of `planspace plan`, `embed` and
`train` except for what `ARTEFACTS` says, and the same command goes on after an interrupt. What loading needs
is then copied to src/planspace/ready, with the SHA-256 of every file in SHA256SUMS.
"""

import argparse
import hashlib
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from planspace.embed.config import TimeHeadConfig
from planspace.embed.fit import fit_embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.plan.demonstrations import plan_demos
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.rl.training import train_policies
from planspace.storage.compiled import use_compilation_cache
from planspace.storage.ready_made import EMBEDDING, HASHES, PLANS, POLICY, READY

FILES = {
    PLANS: ("manifest.json", "shard-*.safetensors"),
    EMBEDDING: ("embedding.json", "embedding.safetensors", "README.md"),
    POLICY: ("policies.json", "policies.safetensors"),
}
"""The files of each part that are copied; logs and checkpoints are not."""
TIME_HEAD = TimeHeadConfig(hidden=(64, 64), features=64)
"""Smaller than the default, for the size of the package."""


@dataclass(frozen=True)
class Artefact:
    """What is made for a task."""

    problem: str
    num_plans: int
    time_head: bool = False
    """Whether the embedding estimates the time to go. Few plans suffice for that only in few dimensions."""
    seeds: int = 1
    """Number of seeds of the embedding, of which the best is kept, and of the policy."""
    policy_steps: int = 0
    """Environment steps per seed of a policy on the state, sin, cos and z; 0 makes none."""


ARTEFACTS = {
    "cartpole-swingup": Artefact("cartpole-swingup", 40, time_head=True, seeds=3, policy_steps=600_000),
    "pendulum-swingup": Artefact("pendulum", 20, time_head=True),
    "quadrotor-planar": Artefact("quadrotor-planar", 20, time_head=True),
    "reacher": Artefact("reacher", 20),
    "quadrotor": Artefact("quadrotor", 15),
    "ball-pendulum": Artefact("ball-pendulum", 15),
    "acrobot-swingup": Artefact("acrobot", 10),
    "arm": Artefact("arm", 10),
}


def main() -> None:
    """Make what the folder does not hold yet, and copy it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="where plans, embeddings and policies are made")
    parser.add_argument("--only", nargs="+", default=list(ARTEFACTS), choices=ARTEFACTS, metavar="NAME")
    options = parser.parse_args()
    use_compilation_cache()
    for name in options.only:
        make(name, options.folder / name)
        copy(options.folder / name, READY / name)
        print(name, f"{size(READY / name) / 1000:.0f} kB", flush=True)
    write_hashes()
    print(f"{size(READY) / 1000:.0f} kB in all")


def make(name: str, folder: Path) -> None:
    """Plan, embed and train."""
    artefact = ARTEFACTS[name]
    demos = plan_demos(artefact.problem, artefact.num_plans, out=folder / PLANS)
    embedding = fit_embedding(
        demos,
        out=folder / EMBEDDING,
        num_seeds=artefact.seeds,
        time_head=TIME_HEAD if artefact.time_head else False,
    )
    if artefact.policy_steps:
        config = TrainConfig(
            find_algorithm("trpo", "modern"),
            obs="trig",
            z="augment",
            num_seeds=artefact.seeds,
            steps=artefact.policy_steps,
        )
        train_policies(name, config, embedding=embedding, out=folder / POLICY)


def copy(made: Path, ready: Path) -> None:
    """Replace the copy of an artefact."""
    if ready.exists():
        shutil.rmtree(ready)
    for part, patterns in FILES.items():
        for source in (file for pattern in patterns for file in sorted((made / part).glob(pattern))):
            target = ready / part / source.name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
    if (ready / POLICY).exists():  # a policy needs only z
        embedding = load_embedding(made / POLICY / "embedding")
        replace(embedding, time_head=None, support=None).save(ready / POLICY / "embedding")


def write_hashes() -> None:
    """Write the list of hashes, in the format of `sha256sum`."""
    files = sorted(file for file in READY.rglob("*") if file.is_file() and file != HASHES)
    lines = [
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.relative_to(READY).as_posix()}\n"
        for file in files
    ]
    HASHES.write_text("".join(lines))


def size(folder: Path) -> int:
    """Bytes of all files in a folder."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


if __name__ == "__main__":
    main()
