"""Demonstrations recorded by Minari's `DataCollector`, and an embedding trained on them.

    pip install '.[minari]'
    python examples/minari_demos.py swingup/expert-v0 --episodes 50 --out embedding

The expert in this example replays plans that were made with the environment's time step. You can use any
controller, agent or person instead.
"""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import gymnasium
import minari
import numpy as np

import planspace
from planspace.embed.config import PRESETS
from planspace.embed.fit import fit_embedding
from planspace.mjcf.assets import ASSETS
from planspace.plan.demonstrations import plan_into
from planspace.tasks.problem import Problem
from planspace.tasks.problem_file import load_problem

TASK = "planspace/CartPoleSwingUp-v0"


def problem_at_env_steps(folder: Path) -> Problem:
    """The swing-up with a time step of 0.04 s, during which the environment holds the control."""
    folder.mkdir(parents=True, exist_ok=True)
    model = (ASSETS / "cartpole.xml").read_text()
    (folder / "cartpole.xml").write_text(model.replace('timestep="0.02"', 'timestep="0.04"'))
    shutil.copy(ASSETS / "cartpole-swingup.yaml", folder)
    return load_problem(str(folder / "cartpole-swingup.yaml"))


def record(dataset_id: str, plans: planspace.Demos) -> None:
    """Replay each plan from its start and store the episodes as a Minari dataset."""
    env = minari.DataCollector(gymnasium.make(TASK), record_infos=True)
    for i in range(len(plans)):
        plan = plans.episode(i)
        env.reset(seed=i, options={"state": plan.states[0]})
        for control in plan.controls:
            obs, *_ = env.step(control.astype(np.float32))
        print(f"episode {i} ends {np.abs(obs).sum():.2f} from the goal")
    env.create_dataset(dataset_id, eval_env=TASK, description="Planned swing-ups of a cart-pole.")
    env.close()


def main() -> None:
    """Record demonstrations and train an embedding on them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset_id", metavar="NAMESPACE/NAME-v0")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--steps", type=int, default=PRESETS["modern"].steps, help="training steps of the embedding"
    )
    arguments = parser.parse_args()
    plans = arguments.out / "plans"
    plan_into(problem_at_env_steps(arguments.out), plans, num=arguments.episodes, seed=0)
    record(arguments.dataset_id, planspace.load_demos(plans))

    demos = planspace.load_demos(f"minari:{arguments.dataset_id}")  # the recording names its task
    config = replace(PRESETS["modern"], steps=arguments.steps)
    fit_embedding(demos, config=config, out=arguments.out / "embedding")
    print(f"the same on the command line: planspace embed minari:{arguments.dataset_id} --out embedding")


if __name__ == "__main__":
    main()
