"""How other libraries train, save and load an agent, for `agent_matrix.py`.

Each agent is a class with `train(env, steps)`, `save(folder)`, the class method `load(folder, env)` and
`act(observations)`, which returns one action for each observation, without noise.
"""
# ruff: noqa: D102  the text above describes the methods

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np

Observations = Sequence[Any]
SEED = 0


class SB3Agent:
    """An algorithm of Stable-Baselines3 or of sb3-contrib."""

    def __init__(self, algorithm: str, model: Any):
        self.algorithm, self.model = algorithm, model

    @staticmethod
    def class_of(algorithm: str) -> Any:
        import sb3_contrib
        import stable_baselines3

        return getattr(stable_baselines3, algorithm, None) or getattr(sb3_contrib, algorithm)

    @classmethod
    def train(cls, algorithm: str, env: gymnasium.Env, steps: int, **arguments: Any) -> "SB3Agent":
        keyed = isinstance(env.observation_space, gymnasium.spaces.Dict)
        policy = "MultiInputPolicy" if keyed else "MlpPolicy"
        if algorithm == "RecurrentPPO":
            policy = "MlpLstmPolicy"
        if "PPO" in algorithm:
            arguments |= {"n_steps": 64, "batch_size": 32}
        else:
            arguments |= {"learning_starts": 150, "batch_size": 32}
        model = cls.class_of(algorithm)(policy, env, seed=SEED, device="cpu", **arguments)
        return cls(algorithm, model.learn(steps))

    def save(self, folder: Path) -> None:
        self.model.save(folder / "agent")

    @classmethod
    def load(cls, algorithm: str, folder: Path, env: gymnasium.Env) -> "SB3Agent":
        return cls(algorithm, cls.class_of(algorithm).load(folder / "agent", env, device="cpu"))

    def act(self, observations: Observations) -> np.ndarray:
        state, actions = None, []  # the state of a recurrent policy
        for obs in observations:
            action, state = self.model.predict(obs, state, deterministic=True)
            actions.append(action)
        return np.stack(actions)


class SkrlAgent:
    """PPO of skrl."""

    def __init__(self, env: gymnasium.Env):
        from skrl import logger
        from skrl.agents.torch.ppo import PPO, PPO_CFG
        from skrl.envs.wrappers.torch import wrap_env
        from skrl.memories.torch import RandomMemory
        from skrl.utils import set_seed
        from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

        logger.setLevel("ERROR")
        set_seed(SEED)
        self.env = wrap_env(env, wrapper="gymnasium", verbose=False)
        spaces = {
            "observation_space": self.env.observation_space,
            "action_space": self.env.action_space,
            "device": "cpu",
        }
        network = [{"name": "net", "input": "OBSERVATIONS", "layers": [32, 32], "activations": "tanh"}]
        models = {
            "policy": gaussian_model(**spaces, network=network, output="ACTIONS"),
            "value": deterministic_model(**spaces, network=network, output="ONE"),
        }
        config = PPO_CFG(rollouts=64)
        config.experiment.write_interval = config.experiment.checkpoint_interval = 0
        self.agent = PPO(models=models, memory=RandomMemory(memory_size=64), cfg=config, **spaces)

    @classmethod
    def train(cls, algorithm: str, env: gymnasium.Env, steps: int) -> "SkrlAgent":
        from skrl.trainers.torch import SequentialTrainer

        ours = cls(env)
        settings = {"timesteps": steps, "headless": True, "disable_progressbar": True}
        SequentialTrainer(env=ours.env, agents=ours.agent, cfg=settings).train()
        return ours

    def save(self, folder: Path) -> None:
        self.agent.save(str(folder / "agent.pt"))

    @classmethod
    def load(cls, algorithm: str, folder: Path, env: gymnasium.Env) -> "SkrlAgent":
        ours = cls(env)
        ours.agent.init()
        ours.agent.load(str(folder / "agent.pt"))
        return ours

    def act(self, observations: Observations) -> np.ndarray:
        import torch

        with torch.no_grad():
            batch = torch.tensor(np.stack(observations), dtype=torch.float32)
            return self.agent.act(batch, None, timestep=0, timesteps=0)[1]["mean_actions"].numpy()


class TianshouAgent:
    """DQN and SAC of tianshou."""

    def __init__(self, algorithm: str, env: gymnasium.Env):
        import torch
        from tianshou.algorithm.modelfree.dqn import DQN, DiscreteQLearningPolicy
        from tianshou.algorithm.modelfree.sac import SAC, SACPolicy
        from tianshou.algorithm.optim import AdamOptimizerFactory
        from tianshou.utils.net.common import Net
        from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic

        torch.manual_seed(SEED)
        shape, optim = env.observation_space.shape, AdamOptimizerFactory(lr=1e-3)
        assert shape is not None
        if algorithm == "DQN":
            num = int(env.action_space.n)  # pyright: ignore
            net = Net(state_shape=shape, action_shape=num, hidden_sizes=[32])
            policy = DiscreteQLearningPolicy(model=net, action_space=env.action_space, eps_training=0.1)
            self.algorithm: Any = DQN(policy=policy, optim=optim, target_update_freq=100)
            return
        actions = env.action_space.shape
        assert actions is not None
        actor = ContinuousActorProbabilistic(
            preprocess_net=Net(state_shape=shape, hidden_sizes=[32]),
            action_shape=actions,
            unbounded=True,
            conditioned_sigma=True,
        )
        critic = ContinuousCritic(
            preprocess_net=Net(state_shape=shape, action_shape=actions, hidden_sizes=[32], concat=True)
        )
        policy = SACPolicy(actor=actor, action_space=env.action_space)
        self.algorithm = SAC(policy=policy, policy_optim=optim, critic=critic, critic_optim=optim)

    @classmethod
    def train(cls, algorithm: str, env: gymnasium.Env, steps: int) -> "TianshouAgent":
        from tianshou.data import Collector, VectorReplayBuffer
        from tianshou.env import DummyVectorEnv
        from tianshou.trainer import OffPolicyTrainerParams

        ours = cls(algorithm, env)
        envs = DummyVectorEnv([lambda: env])
        collector = Collector[Any](ours.algorithm, envs, VectorReplayBuffer(1000, 1), exploration_noise=True)
        ours.algorithm.run_training(
            OffPolicyTrainerParams(
                training_collector=collector,
                max_epochs=1,
                epoch_num_steps=steps,
                collection_step_num_env_steps=10,
                batch_size=32,
                update_step_num_gradient_steps_per_sample=0.5,
                show_progress=False,
                verbose=False,
            )
        )
        return ours

    def save(self, folder: Path) -> None:
        import torch

        torch.save(self.algorithm.policy.state_dict(), folder / "agent.pt")

    @classmethod
    def load(cls, algorithm: str, folder: Path, env: gymnasium.Env) -> "TianshouAgent":
        import torch

        ours = cls(algorithm, env)
        ours.algorithm.policy.load_state_dict(torch.load(folder / "agent.pt", weights_only=True))
        return ours

    def act(self, observations: Observations) -> np.ndarray:
        import torch
        from tianshou.data import Batch

        policy = self.algorithm.policy.eval()
        with torch.no_grad():
            batch = Batch(obs=np.stack(observations).astype(np.float32), info=Batch())
            return policy.map_action(np.asarray(policy(batch).act))


class D3rlpyAgent:
    """SAC and DQN of d3rlpy, trained online."""

    def __init__(self, model: Any):
        self.model = model

    @classmethod
    def train(cls, algorithm: str, env: gymnasium.Env, steps: int) -> "D3rlpyAgent":
        import d3rlpy
        import structlog

        structlog.configure(logger_factory=structlog.ReturnLoggerFactory())  # it prints every setting
        d3rlpy.seed(SEED)
        config = d3rlpy.algos.SACConfig if algorithm == "SAC" else d3rlpy.algos.DQNConfig
        model = config(batch_size=32).create(device="cpu:0")
        model.fit_online(
            env,
            d3rlpy.dataset.create_fifo_replay_buffer(limit=1000, env=env),
            n_steps=steps,
            n_steps_per_epoch=steps,
            update_start_step=150,
            show_progress=False,
            logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
        )
        return cls(model)

    def save(self, folder: Path) -> None:
        self.model.save(str(folder / "agent.d3"))

    @classmethod
    def load(cls, algorithm: str, folder: Path, env: gymnasium.Env) -> "D3rlpyAgent":
        import d3rlpy

        return cls(d3rlpy.load_learnable(str(folder / "agent.d3"), device="cpu:0"))

    def act(self, observations: Observations) -> np.ndarray:
        return self.model.predict(np.stack(observations).astype(np.float32))


class LoopAgent:
    """A policy-gradient loop in one file, in the style of CleanRL, on a vector environment of Gymnasium."""

    DISCOUNT: ClassVar[float] = 0.99

    def __init__(self, env: gymnasium.Env):
        import torch

        torch.manual_seed(SEED)
        num_obs, num_actions = env.observation_space.shape[0], env.action_space.shape[0]  # pyright: ignore
        self.mean = torch.nn.Sequential(
            torch.nn.Linear(num_obs, 32), torch.nn.Tanh(), torch.nn.Linear(32, num_actions)
        )

    @classmethod
    def train(cls, algorithm: str, env: gymnasium.Env, steps: int) -> "LoopAgent":
        import torch

        ours, num_envs, rollout = cls(env), 4, 25
        assert env.spec is not None
        envs = gymnasium.make_vec(env.spec, num_envs=num_envs, vectorization_mode="sync")
        optimiser = torch.optim.Adam(ours.mean.parameters(), lr=1e-3)
        obs, _ = envs.reset(seed=SEED)
        for _ in range(steps // (num_envs * rollout)):
            log_probs, rewards, goes_on = [], [], []
            for _ in range(rollout):
                noise = torch.distributions.Normal(ours.mean(torch.tensor(obs, dtype=torch.float32)), 1.0)
                actions = noise.sample()
                log_probs.append(noise.log_prob(actions).sum(-1))
                obs, reward, terminated, truncated, _ = envs.step(actions.numpy())
                rewards.append(torch.tensor(reward, dtype=torch.float32))
                goes_on.append(torch.tensor(~(terminated | truncated), dtype=torch.float32))
            returns, after = [], torch.zeros(num_envs)
            for reward, going in zip(reversed(rewards), reversed(goes_on), strict=True):
                after = reward + cls.DISCOUNT * going * after
                returns.insert(0, after)
            advantages = torch.stack(returns) - torch.stack(returns).mean()
            optimiser.zero_grad()
            (-(torch.stack(log_probs) * advantages).mean()).backward()
            optimiser.step()
        return ours

    def save(self, folder: Path) -> None:
        import torch

        torch.save(self.mean.state_dict(), folder / "agent.pt")

    @classmethod
    def load(cls, algorithm: str, folder: Path, env: gymnasium.Env) -> "LoopAgent":
        import torch

        ours = cls(env)
        ours.mean.load_state_dict(torch.load(folder / "agent.pt", weights_only=True))
        return ours

    def act(self, observations: Observations) -> np.ndarray:
        import torch

        with torch.no_grad():
            return self.mean(torch.tensor(np.stack(observations), dtype=torch.float32)).numpy()


LIBRARIES: dict[str, Any] = {
    "stable-baselines3": SB3Agent,
    "sb3-contrib": SB3Agent,
    "skrl": SkrlAgent,
    "tianshou": TianshouAgent,
    "d3rlpy": D3rlpyAgent,
    "own loop (CleanRL style)": LoopAgent,
}
