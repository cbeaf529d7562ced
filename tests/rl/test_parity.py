"""Our updates equal those of Stable-Baselines3 and sb3-contrib, from the same weights and the same batch."""

from typing import Any

import equinox as eqx
import gymnasium
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace.rl import ppo_update as ppo
from planspace.rl import sac_update as sac
from planspace.rl import trpo_update as trpo
from planspace.rl.algorithms.ppo import PPO
from planspace.rl.algorithms.sac import SAC
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.policy import GaussianPolicy

sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra sb3")
sb3_contrib = pytest.importorskip("sb3_contrib", reason="needs the extra sb3")

NUM, NUM_OBS = 256, 4
PPO_TOLERANCE = 2e-6
"""Relative to 1e-3, an Adam step is g / (|g| + 1e-8): if g is almost 0, rounding decides its sign."""
SAC_TOLERANCE = 0.03
"""Fraction of the largest step. Where a gradient is almost 0, rounding decides the size of Adam's step."""
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


def sac_layers(agent: Any) -> dict[str, list[list]]:
    """The layers of each of their networks; the last layer of the actor consists of two modules."""
    found = {"actor": [[agent.actor.latent_pi[0]], [agent.actor.latent_pi[2]]]}
    found["actor"].append([agent.actor.mu, agent.actor.log_std])
    for name, critic in {"critic": agent.critic, "target": agent.critic_target}.items():
        for i, network in enumerate((critic.qf0, critic.qf1)):
            found[f"{name} {i}"] = [[network[k]] for k in (0, 2, 4)]
    return found


def our_sac_layers(learner: sac.Learner) -> dict[str, list[np.ndarray]]:
    """Weights and biases of each layer, side by side."""
    pairs = zip(("critic", "target"), (learner.critics, learner.targets), strict=True)
    networks = {f"{name} {i}": two[i] for name, two in pairs for i in range(2)} | {"actor": learner.actor}
    return {
        name: [np.column_stack(layer) for layer in zip(network.weights, network.biases, strict=True)]
        for name, network in networks.items()
    }


def test_one_update_of_sac_equals_that_of_sb3(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch
    from stable_baselines3.common.type_aliases import ReplayBufferSamples

    rng = np.random.default_rng(0)
    draw = lambda *size: rng.normal(size=size).astype(np.float32)  # noqa: E731
    obs, next_obs, actions, rewards = draw(NUM, NUM_OBS), draw(NUM, NUM_OBS), np.tanh(draw(NUM, 1)), draw(NUM)
    noise, terminated = (draw(NUM, 1), draw(NUM, 1)), rng.random(NUM) < 0.3
    learner = sac.new_learner(SAC(temperature=0.3), NUM_OBS, NUM_OBS, 1, key=jr.key(2))
    targets = sac.new_learner(SAC(), NUM_OBS, NUM_OBS, 1, key=jr.key(3)).critics
    learner = eqx.tree_at(lambda x: x.targets, learner, targets)
    env = gymnasium.make("planspace/CartPoleSwingUp-v0")
    agent = sb3.SAC("MlpPolicy", env, ent_coef="auto_0.3", device="cpu")
    for name, layers in sac_layers(agent).items():
        for modules, layer in zip(layers, our_sac_layers(learner)[name], strict=True):
            for module, part in zip(modules, np.split(layer, len(modules)), strict=True):
                module.weight.data, module.bias.data = torch.tensor(part[:, :-1]), torch.tensor(part[:, -1])
    parts = obs, actions, next_obs, terminated[:, None].astype(np.float32), rewards[:, None]
    samples, queue = ReplayBufferSamples(*map(torch.tensor, parts)), list(map(torch.tensor, noise))
    monkeypatch.setattr(agent.replay_buffer, "sample", lambda *args, **options: samples)
    monkeypatch.setattr(torch.distributions.normal, "_standard_normal", lambda *args, **options: queue.pop(0))
    agent.set_logger(sb3.common.logger.Logger(None, []))
    agent.train(gradient_steps=1, batch_size=NUM)

    batch = sac.Batch(*map(jnp.asarray, (obs, obs, actions, rewards, next_obs, next_obs, terminated)))
    ours, info = eqx.filter_jit(sac.gradient_step)(SAC(), learner, batch, sac.Noise(*map(jnp.asarray, noise)))
    for name, layers in sac_layers(agent).items():
        for k, modules in enumerate(layers):
            rows = [np.column_stack([m.weight.detach(), m.bias.detach()]) for m in modules]
            moved = our_sac_layers(ours)[name][k] - our_sac_layers(learner)[name][k]
            difference = our_sac_layers(ours)[name][k] - np.concatenate(rows)
            assert np.abs(difference).max() < SAC_TOLERANCE * np.abs(moved).max(), name
    assert agent.log_ent_coef.item() == pytest.approx(float(ours.log_alpha), abs=1e-7)
    logged = agent.logger.name_to_value
    assert logged["train/critic_loss"] == pytest.approx(float(info.critic_loss), rel=1e-5)
    assert logged["train/actor_loss"] == pytest.approx(float(info.actor_loss), rel=1e-5)
