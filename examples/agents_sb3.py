"""A Stable-Baselines3 agent that observes z: PPO, or TRPO from sb3-contrib, on the swing-up.

    pip install '.[sb3]'
    python examples/agents_sb3.py EMBEDDING --agent trpo --steps 500000

EMBEDDING is a folder written by `planspace embed` or `planspace run`. `--workers ours` steps all episodes on
one batch of physics. `--workers subproc` uses SB3's own vector environment, with one process per episode.
"""

import argparse
from functools import partial

import gymnasium
from sb3_contrib import TRPO
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env as make_sb3_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv, VecNormalize

from planspace.envs.sb3 import make_vec_env
from planspace.envs.wrappers import PlanSpaceObservation

TASK = "planspace/CartPoleSwingUp-v0"
AGENTS = {"ppo": PPO, "trpo": TRPO}


def make_envs(workers: str, num: int, embedding: str, seed: int) -> VecEnv:
    """Make swing-ups that observe the state, sin and cos of the pole's angle, and z."""
    if workers == "ours":
        return make_vec_env(TASK, num, seed, embedding, env_kwargs={"obs": "trig"})
    return make_sb3_vec_env(
        partial(gymnasium.make, TASK, obs="trig"),
        n_envs=num,
        seed=seed,
        vec_env_cls=SubprocVecEnv,
        vec_env_kwargs={"start_method": "spawn"},
        wrapper_class=PlanSpaceObservation,
        wrapper_kwargs={"embedding": embedding},
    )


def main() -> None:
    """Train an agent and print its return."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("embedding", metavar="EMBEDDING")
    parser.add_argument("--agent", choices=AGENTS, default="ppo")
    parser.add_argument("--workers", choices=["ours", "subproc"], default="ours")
    parser.add_argument("--num-envs", type=int, default=20)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    plain = make_envs(arguments.workers, arguments.num_envs, arguments.embedding, arguments.seed)
    envs = VecNormalize(plain, gamma=0.99)
    rollout = 4000 // arguments.num_envs  # 4,000 steps per iteration
    agent = AGENTS[arguments.agent](
        "MlpPolicy", envs, n_steps=rollout, batch_size=500, seed=arguments.seed, device="cpu", verbose=1
    )
    agent.learn(arguments.steps)
    envs.training = envs.norm_reward = False
    mean, spread = evaluate_policy(agent, envs, n_eval_episodes=arguments.num_envs)
    print(f"return {mean:.1f} (standard deviation over episodes {spread:.1f})")
    envs.close()


if __name__ == "__main__":
    main()
