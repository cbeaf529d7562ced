"""An embedding for one of Gymnasium's own MuJoCo environments.

    python examples/gymnasium_mujoco.py Reacher-v5 --out reacher        # or InvertedPendulum-v5

The script plans demonstrations with the MJCF file of the environment, trains an embedding on them, and adds z
to the observation. The wrapper finds the joints it needs by name.
"""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium.envs import mujoco as gymnasium_mujoco

import planspace
from planspace.embed.config import PRESETS
from planspace.embed.fit import fit_embedding
from planspace.envs.wrappers import PlanSpaceObservation
from planspace.plan.demonstrations import plan_into
from planspace.tasks.problem_file import load_problem

ASSETS = Path(gymnasium_mujoco.__file__).parent / "assets"

PROBLEMS = {
    "Reacher-v5": (
        "reacher.xml",
        """
model: reacher.xml
joints: [joint0, joint1]
start: {low: [-3.1, -2.9, -0.1, -0.1], high: [3.1, 2.9, 0.1, 0.1]}
goal: [0.0, 1.57, 0.0, 0.0]
tolerance: 0.1
feature_weights: [0.4, 0.4, 0.04, 0.04]
sample_velocity: [25.0, 25.0]
""",
    ),
    "InvertedPendulum-v5": (
        "inverted_pendulum.xml",
        """
model: inverted_pendulum.xml
joints: [slider, hinge]
start: {low: [-0.2, -0.4, -0.1, -0.1], high: [0.2, 0.4, 0.1, 0.1]}
goal: [0.0, 0.0, 0.0, 0.0]
tolerance: 0.1
""",
    ),
}


def main() -> None:
    """Plan, train an embedding, and step the environment with z."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("env_id", choices=PROBLEMS)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--num", type=int, default=100, help="number of demonstrations")
    parser.add_argument(
        "--steps", type=int, default=PRESETS["modern"].steps, help="training steps of the embedding"
    )
    arguments = parser.parse_args()

    model, problem = PROBLEMS[arguments.env_id]
    arguments.out.mkdir(parents=True, exist_ok=True)
    shutil.copy(ASSETS / model, arguments.out)
    (arguments.out / "problem.yaml").write_text(problem)
    demos = arguments.out / "demos"
    plan_into(load_problem(str(arguments.out / "problem.yaml")), demos, num=arguments.num, seed=0)
    config = replace(PRESETS["modern"], steps=arguments.steps)
    fit_embedding(planspace.load_demos(demos), config=config, out=arguments.out / "embedding")

    env = PlanSpaceObservation(gymnasium.make(arguments.env_id), arguments.out / "embedding")
    obs, _ = env.reset(seed=0)
    before = env.unwrapped.observation_space.shape
    print(f"{arguments.env_id}: the observation has {before[0]} numbers, and {len(obs)} with z")
    env.action_space.seed(0)
    z = [env.step(env.action_space.sample())[0][-env.embedding.z_dim :] for _ in range(5)]
    print("z in five random steps:\n", np.round(z, 3))


if __name__ == "__main__":
    main()
