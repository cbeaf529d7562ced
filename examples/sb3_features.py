"""A Stable-Baselines3 agent whose policy computes z itself, on its own device: PPO on the swing-up.

    pip install '.[sb3]'
    python examples/sb3_features.py EMBEDDING --device cuda

EMBEDDING is a folder written by `planspace embed` or `planspace run`. The environments and the rollout buffer
hold states without z; the features extractor appends z. `--fine-tune` lets PPO change the encoder, too.
"""

import argparse

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

import planspace as ps
from planspace.envs.sb3 import make_vec_env


class PlanSpaceFeatures(BaseFeaturesExtractor):
    """The observation and the z of its first numbers, which are the state."""

    def __init__(self, observation_space: gymnasium.spaces.Box, embedding: ps.Embedding, trainable: bool):
        encoder = ps.torch_module(embedding, trainable=trainable)
        super().__init__(observation_space, observation_space.shape[0] + encoder.z_dim)
        self.encoder = encoder

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Append z to observations [batch, obs]."""
        return torch.cat((obs, self.encoder(obs[:, : self.encoder.state_dim])), dim=-1)


def main() -> None:
    """Train an agent and print its return."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("embedding", metavar="EMBEDDING")
    parser.add_argument("--num-envs", type=int, default=20)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fine-tune", action="store_true")
    arguments = parser.parse_args()

    envs = make_vec_env("planspace/CartPoleSwingUp-v0", arguments.num_envs, seed=0)
    embedding = ps.load_embedding(arguments.embedding)
    agent = PPO(
        "MlpPolicy",
        envs,  # without VecNormalize: the encoder standardises the states itself
        n_steps=4000 // arguments.num_envs,
        batch_size=500,
        device=arguments.device,
        seed=0,
        policy_kwargs=dict(
            features_extractor_class=PlanSpaceFeatures,
            features_extractor_kwargs=dict(embedding=embedding, trainable=arguments.fine_tune),
        ),
    )
    agent.learn(arguments.steps)
    mean, _ = evaluate_policy(agent, envs, n_eval_episodes=arguments.num_envs)
    print(f"features {agent.policy.features_extractor.features_dim}, return {mean:.1f}")
    envs.close()


if __name__ == "__main__":
    main()
