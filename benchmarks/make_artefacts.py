"""Make the ready-made artefacts that the package brings: plans, embeddings and policies of shipped tasks.

    python benchmarks/make_artefacts.py runs/artefacts

Plans, embeddings and policies are made in the folder, with the defaults of `planspace plan`, `embed` and
`train` except for what `ARTEFACTS` says, and the same command goes on after an interrupt. What loading needs
is then copied to src/planspace/ready, with the SHA-256 of every file in SHA256SUMS.

    python benchmarks/make_artefacts.py runs/artefacts --control

controls 20 starts of each task with its embedding, at the default settings of `planspace control` (the
acrobot with 0.64 s of foresight), by distance in z and, if the embedding has it, by time to go. Episodes last
as long as in `control.py`. results/control/ready_made.csv has the fraction of starts from which the robot is
at the goal for the whole last second.
"""

import argparse
import hashlib
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from csv_rows import has_row, read_rows, write_rows

from control import PROBLEMS
from planspace.control.config import ControlConfig
from planspace.control.plant import Plant
from planspace.control.runs import control_into
from planspace.embed.config import TimeHeadConfig
from planspace.embed.fit import fit_embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_demos
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.rl.training import train_policies
from planspace.storage.compiled import use_compilation_cache
from planspace.storage.ready_made import EMBEDDING, HASHES, PLANS, POLICY, READY
from planspace.tasks.problem_file import load_problem

FILES = {
    PLANS: ("manifest.json", "shard-*.safetensors"),
    EMBEDDING: ("embedding.json", "embedding.safetensors", "README.md"),
    POLICY: ("policies.json", "policies.safetensors"),
}
"""The files of each part that are copied; logs and checkpoints are not."""
CONTROLLED = Path(__file__).parents[1] / "results" / "control" / "ready_made.csv"
HORIZON_S = {"acrobot-swingup": 0.64}
"""Foresight of control, where it is not the default [s]."""
COLUMNS, NUM_STARTS = ("task", "cost", "embedding", "success"), 20
SMALL = TimeHeadConfig(hidden=(64, 64), features=64)
"""For few plans in few dimensions, and for the size of the package."""


@dataclass(frozen=True)
class Artefact:
    """What is made for a task."""

    problem: str
    num_plans: int
    """Plans that are brought along."""
    num_training: int = 0
    """Plans with search trees, too large to bring along, that the embedding learns from. It has then not seen
    those that are brought along. 0: it learns from those."""
    time_head: TimeHeadConfig | None = None
    """What estimates the time to go; None for nothing. Without search trees, that needs few dimensions."""
    seeds: int = 1
    """Number of seeds of the embedding, of which the best is kept, and of the policy."""
    policy_steps: int = 0
    """Environment steps per seed of a policy on the state, sin, cos and z; 0 makes none."""


ARTEFACTS = {
    "cartpole-swingup": Artefact("cartpole-swingup", 40, time_head=SMALL, seeds=3, policy_steps=600_000),
    "pendulum-swingup": Artefact("pendulum", 20, time_head=SMALL),
    "quadrotor-planar": Artefact("quadrotor-planar", 20, time_head=SMALL),
    "reacher": Artefact("reacher", 20),
    "quadrotor": Artefact("quadrotor", 15, num_training=60),
    "ball-pendulum": Artefact("ball-pendulum", 15, num_training=60, time_head=TimeHeadConfig(), seeds=5),
    "acrobot-swingup": Artefact("acrobot", 10, num_training=60, time_head=TimeHeadConfig(), seeds=5),
    "arm": Artefact("arm", 10),
}


def main() -> None:
    """Make what the folder does not hold yet, and copy it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="where plans, embeddings and policies are made")
    parser.add_argument("--only", nargs="+", default=list(ARTEFACTS), choices=ARTEFACTS, metavar="NAME")
    parser.add_argument("--control", action="store_true", help="control with what the package brings")
    options = parser.parse_args()
    use_compilation_cache()
    if options.control:
        control(options.only, options.folder)
        return
    for name in options.only:
        make(name, options.folder / name)
        copy(options.folder / name, READY / name)
        print(name, f"{size(READY / name) / 1000:.0f} kB", flush=True)
    write_hashes()
    print(f"{size(READY) / 1000:.0f} kB in all")


def make(name: str, folder: Path) -> None:
    """Plan, embed and train."""
    artefact = ARTEFACTS[name]
    seed = 1 if artefact.num_training else 0
    learned = plan_demos(artefact.problem, artefact.num_plans, seed=seed, out=folder / PLANS)
    if artefact.num_training:
        config = PlanConfig.for_problem(load_problem(artefact.problem), keep_trees=True)
        learned = plan_demos(artefact.problem, artefact.num_training, config=config, out=folder / "training")
    embedding = fit_embedding(
        learned,
        out=folder / EMBEDDING,
        num_seeds=artefact.seeds,
        time_head=artefact.time_head or False,
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


def control(names: list[str], folder: Path) -> None:
    """Control with the ready-made embeddings, and add what the results do not have yet."""
    for name in names:
        embedding = load_embedding(name)
        for cost in ("z", "time") if embedding.time_head else ("z",):
            key = {"task": name, "cost": cost, "embedding": embedding.hash[:12]}
            rows = read_rows(CONTROLLED)
            if has_row(rows, key):
                continue
            found = control_into(
                Plant.find(name),
                embedding,
                ControlConfig(cost="time" if cost == "time" else "z", horizon_s=HORIZON_S.get(name, 0.32)),
                folder / f"control-{name}-{cost}-{key['embedding']}",
                num=NUM_STARTS,
                seed=0,
                episode_s=PROBLEMS[name],
            )
            kept = [row for row in rows if (row["task"], row["cost"]) != (name, cost)]
            write_rows(CONTROLLED, COLUMNS, [*kept, key | {"success": f"{found.success:.2f}"}])
            print(name, cost, f"{found.success:.0%}", flush=True)


def size(folder: Path) -> int:
    """Bytes of all files in a folder."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


if __name__ == "__main__":
    main()
