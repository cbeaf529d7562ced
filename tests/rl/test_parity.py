"""Our updates equal those of Stable-Baselines3 and sb3-contrib, from the same weights and the same batch."""

from typing import Any

import equinox as eqx
import gymnasium
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace.rl import ppo_update as ppo
from planspace.rl import trpo_update as trpo
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.policy import GaussianPolicy

sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra sb3")
sb3_contrib = pytest.importorskip("sb3_contrib", reason="needs the extra sb3")

NUM, NUM_OBS = 256, 4
PPO_TOLERANCE = 2e-6
"""Relative to 1e-3, an Adam step is g / (|g| + 1e-8): if g is almost 0, rounding decides its sign."""
TRPO_TOLERANCE = 1e-3
"""Fraction of the largest step. With a damping of 0.1, sb3-contrib's default, the two differ by 1e-4. With
1e-5, as in the 2020 runs, ten conjugate gradient steps in float32 amplify rounding to 0.03 (cosine 0.999)."""


@pytest.fixture
def batch() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    obs = rng.normal(size=(NUM, NUM_OBS)).astype(np.float32)
    actions = rng.normal(size=(NUM, 1)).astype(np.float32)
    advantages = (actions[:, 0] * obs[:, 0] + 0.3 * rng.normal(size=NUM)).astype(np.float32)
    return obs, actions, advantages


def theirs(kind: Any, batch: tuple, policy: GaussianPolicy, **settings: Any) -> Any:
    """An agent of theirs with our weights; its rollout buffer contains the batch."""
    import torch

    env = gymnasium.make("planspace/CartPoleSwingUp-v0")
    agent = kind(
        "MlpPolicy",
        env,
        n_steps=NUM,
        batch_size=NUM,
        normalize_advantage=False,
        device="cpu",
        policy_kwargs={"net_arch": [32, 32], "optimizer_kwargs": {"eps": 1e-8}},
        **settings,
    )
    layers = [agent.policy.mlp_extractor.policy_net[0], agent.policy.mlp_extractor.policy_net[2]]
    with torch.no_grad():
        for layer, weight, bias in zip(
            [*layers, agent.policy.action_net], policy.mean.weights, policy.mean.biases, strict=True
        ):
            layer.weight.copy_(torch.tensor(np.asarray(weight)))
            layer.bias.copy_(torch.tensor(np.asarray(bias)))
        agent.policy.log_std.copy_(torch.tensor(np.asarray(policy.log_std)))
    obs, actions, advantages = batch
    buffer = agent.rollout_buffer
    log_prob = np.asarray(policy.log_prob(jnp.asarray(obs), jnp.asarray(actions)))
    for name, values in {"observations": obs, "actions": actions}.items():
        getattr(buffer, name)[:] = values[:, None]
    for name, values in {"advantages": advantages, "log_probs": log_prob}.items():
        getattr(buffer, name)[:] = values[:, None]
    buffer.full, buffer.pos = True, NUM
    agent.set_logger(sb3.common.logger.Logger(None, []))
    agent.train()
    return agent


def parameters(agent: Any) -> np.ndarray:
    """Their parameters in the order of ours."""
    net = agent.policy.mlp_extractor.policy_net
    layers = [net[0], net[2], agent.policy.action_net]
    parts = [layer.weight for layer in layers] + [layer.bias for layer in layers] + [agent.policy.log_std]
    return np.concatenate([part.detach().numpy().ravel() for part in parts])


def our_parameters(policy: GaussianPolicy) -> np.ndarray:
    parts = [*policy.mean.weights, *policy.mean.biases, policy.log_std]
    return np.concatenate([np.asarray(part).ravel() for part in parts])


def test_one_minibatch_of_ppo_equals_that_of_sb3(batch: tuple) -> None:
    policy = GaussianPolicy(NUM_OBS, 1, key=jr.key(3))
    settings = {"learning_rate": 1e-3, "n_epochs": 1, "vf_coef": 0.0, "ent_coef": 0.0, "max_grad_norm": 0.5}
    agent = theirs(sb3.PPO, batch, policy, clip_range=0.2, **settings)
    config = PPO(epochs=1, minibatch=NUM, of_steps=True, tolerance=0.0, clip_norm=0.5)
    obs, actions, advantages = map(jnp.asarray, batch)
    samples = ppo.Batch(obs, actions, advantages, policy.log_prob(obs, actions))
    ours, _, info = ppo.update(policy, ppo.optimiser(config).init(policy), samples, config, key=jr.key(0))
    assert not info.skipped
    moved = np.abs(our_parameters(ours) - our_parameters(policy))
    assert np.median(moved) == pytest.approx(1e-3, rel=0.01)
    np.testing.assert_allclose(our_parameters(ours), parameters(agent), atol=PPO_TOLERANCE)


def test_one_update_of_trpo_equals_that_of_sb3_contrib(batch: tuple) -> None:
    policy = GaussianPolicy(NUM_OBS, 1, key=jr.key(3))
    settings = {"cg_max_steps": 10, "cg_damping": 0.1, "target_kl": 0.01, "n_critic_updates": 1}
    line_search = {"line_search_shrinking_factor": 0.8, "line_search_max_iter": 15, "sub_sampling_factor": 1}
    agent = theirs(sb3_contrib.TRPO, batch, policy, **settings, **line_search)
    obs, actions, advantages = map(jnp.asarray, batch)
    ours, info = eqx.filter_jit(trpo.update)(policy, obs, actions, advantages, TRPO(cg_damping=0.1))
    assert not info.skipped
    step = our_parameters(ours) - our_parameters(policy)
    difference = our_parameters(ours) - parameters(agent)
    assert np.abs(step).max() > 0.01
    assert np.abs(difference).max() < TRPO_TOLERANCE * np.abs(step).max()
