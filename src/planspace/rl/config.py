"""What is trained and how: arms, algorithms, presets. Imports no JAX, so that `--help` answers at once."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

from planspace.errors import UsageError, unknown
from planspace.tasks.observation_types import ObservationType, RewardType

BATCH_STEPS = 4000
"""Steps an iteration and seed (the 2020 runs: 20 episodes of 200, or 40 of 100)."""

Algo = Literal["trpo", "ppo"]
RLPreset = Literal["paper", "modern"]
CriticName = Literal["linear", "mlp"]
ZMode = Literal["none", "augment", "replace"]
ZTarget = Literal["both", "policy", "critic"]
ShapingType = Literal["none", "z", "raw"]


@dataclass(frozen=True)
class TRPOConfig:
    """Settings of TRPO; the defaults are the 2020 runs'."""

    max_kl: float = 0.01
    """Bound on the mean KL of an update [nat]."""
    cg_steps: int = 10
    """Conjugate gradient steps."""
    cg_damping: float = 1e-5
    """Added to the diagonal of the Fisher matrix."""
    backtrack_ratio: float = 0.8
    """Each rejected step is followed by one shorter by this factor."""
    max_backtracks: int = 15
    """Rejected steps before the update is given up and the parameters stay as they were."""


@dataclass(frozen=True)
class PPOConfig:
    """Settings of PPO; the defaults are the 2020 runs'."""

    clip: float = 0.2
    """How far the probability ratio counts from 1."""
    learning_rate: float = 1e-3
    """Adam's."""
    epochs: int = 10
    """Passes over an iteration's samples."""
    minibatch: int = 32
    """Trajectories a minibatch, or, with `of_steps`, steps."""
    of_steps: bool = False
    """Whether minibatches are of steps drawn from all episodes, and not of whole trajectories."""
    tolerance: float = 1e-6
    """An epoch that moves the loss by less is the last; 0 never stops early."""
    clip_norm: float | None = None
    """Gradients are clipped to this norm."""


@dataclass(frozen=True)
class LearnerConfig:
    """How an algorithm learns; presets are in `PRESETS`."""

    discount: float = 0.99
    """gamma."""
    gae_lambda: float = 0.98
    """lambda of the advantage estimate."""
    critic: CriticName = "linear"
    """`linear` features and ridge regression, or an `mlp` with tanh units."""
    hidden: tuple[int, ...] = (32, 32)
    """Units of the policy's hidden layers (paper, RL performance)."""
    critic_hidden: tuple[int, ...] = (32, 32)
    """Units of the hidden layers of an `mlp` critic."""
    match_z: int = 0
    """Makes policy and `mlp` critic so wide that they have as many parameters as with z of so many numbers
    beside the observation: a control for what z adds."""
    layer_norm: bool = False
    """Whether the policy's hidden layers are normalised."""
    normalise_obs: bool = False
    """Whether each seed standardises observations by what it has seen so far."""
    normalise_advantages: bool = True
    """Whether advantages are brought to mean 0 and deviation 1 in each iteration."""
    bootstrap_timeout: bool = False
    """Whether what lies beyond the time limit counts; the 2020 runs took it as nothing."""
    entropy_reward: float = 0.0
    """Added to each reward for a nat of the policy's entropy, without a gradient."""
    trpo: TRPOConfig = field(default_factory=TRPOConfig)
    """Settings of the update, if the algorithm is TRPO."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    """Settings of the update, if it is PPO."""

    def __post_init__(self) -> None:
        """Checks names and sizes.

        Raises:
            UsageError: there is no such critic, a layer has no units, or `match_z` is negative.
        """
        if self.critic not in get_args(CriticName):
            raise unknown("critic", self.critic, get_args(CriticName))
        for layers in (self.hidden, self.critic_hidden):
            if not layers or min(layers) < 1:
                raise UsageError(f"networks need layers of at least one unit, got {layers}.")
        if self.match_z < 0:
            raise UsageError(f"z has at least 0 numbers, got match_z = {self.match_z}.")


PRESETS: dict[tuple[Algo, RLPreset], LearnerConfig] = {
    ("trpo", "paper"): LearnerConfig(),
    ("ppo", "paper"): LearnerConfig(
        gae_lambda=0.95, critic="mlp", normalise_advantages=False, entropy_reward=0.02
    ),
    # not the linear critic: what it says beyond the time limit feeds on itself and can run away
    ("trpo", "modern"): LearnerConfig(
        gae_lambda=0.95,
        critic="mlp",
        normalise_obs=True,
        bootstrap_timeout=True,
        trpo=TRPOConfig(max_kl=0.02),
    ),
    ("ppo", "modern"): LearnerConfig(
        gae_lambda=0.95,
        critic="mlp",
        normalise_obs=True,
        bootstrap_timeout=True,
        ppo=PPOConfig(learning_rate=5e-4, minibatch=125, of_steps=True, tolerance=0.0, clip_norm=0.5),
    ),
}
"""`paper`: the paper, and where it is silent the garage release the 2020 runs used. `modern`: what measured
best. The two are never mixed in one table."""


@dataclass(frozen=True)
class TrainConfig:
    """One arm."""

    task: str
    """The task's name."""
    algo: Algo = "trpo"
    """The algorithm."""
    obs: ObservationType = "raw"
    """`raw`; `wrapped`: angles on a circle within (-pi, pi]; `trig`: raw with sin and cos of its angles."""
    z: ZMode = "none"
    """`none`, `augment`: the observation with z appended, `replace`: z alone."""
    z_to: ZTarget = "both"
    """Who sees z."""
    reward: RewardType = "dense"
    """The form of reward."""
    shaping: ShapingType = "none"
    """What coming nearer to the goal is rewarded by, beside the task's reward: distance in `z`, or between
    `raw` states; potential-based, so that the best policy stays what it was."""
    shaping_scale: float = 10.0
    """What the way from a mean start to the goal is worth in return."""
    num_seeds: int = 5
    """How many seeds."""
    seed: int = 0
    """The first of them."""
    steps: int = 960_000
    """Environment steps a seed; rounded up to whole iterations."""
    eval_every: int = 25
    """Iterations between evaluations by deterministic episodes; 0 evaluates at the end alone."""
    preset: RLPreset = "paper"
    """Where `learner` comes from."""
    learner: LearnerConfig | None = None
    """How it learns, where that is not the preset's."""

    def __post_init__(self) -> None:
        """Checks names and sizes.

        Raises:
            UsageError: there is no such algorithm, preset or form, fewer than one seed or step, a negative
                seed, less than none between evaluations, a shaping worth nothing, or somebody is to see a z
                that there is not.
        """
        names = {
            "algo": Algo,
            "preset": RLPreset,
            "obs": ObservationType,
            "z": ZMode,
            "z_to": ZTarget,
            "reward": RewardType,
            "shaping": ShapingType,
        }
        for name, known in names.items():
            if getattr(self, name) not in get_args(known):
                raise unknown(name, getattr(self, name), get_args(known))
        if self.z == "none" and self.z_to != "both":
            raise UsageError(f"z_to is {self.z_to!r}, but there is no z: give --z augment or --z replace.")
        if not 0 < self.shaping_scale < math.inf:
            raise UsageError(f"the scale of the shaping is above 0, got {self.shaping_scale}.")
        if self.seed < 0:
            raise UsageError(f"seeds are at least 0, got {self.seed}.")
        if self.eval_every < 0:
            raise UsageError(f"evaluations must not be less than 0 iterations apart, got {self.eval_every}.")
        if self.num_seeds < 1 or self.steps < 1:
            raise UsageError(f"seeds and steps must be at least 1, got {self.num_seeds} and {self.steps}.")

    @property
    def needs_embedding(self) -> bool:
        """Whether z is seen or rewarded."""
        return self.z != "none" or self.shaping == "z"

    @property
    def learns(self) -> LearnerConfig:
        """How it learns."""
        return self.learner or PRESETS[self.algo, self.preset]

    def learning(self, **changes: Any) -> "TrainConfig":
        """A copy that learns otherwise, in the fields of `LearnerConfig` named."""
        return replace(self, learner=replace(self.learns, **changes))

    @property
    def seeds(self) -> range:
        """The seeds that are trained."""
        return range(self.seed, self.seed + self.num_seeds)

    @property
    def evaluations(self) -> tuple[int, ...]:
        """Iterations after which the policies are evaluated: every `eval_every`, and the last."""
        due = range(self.eval_every, self.iterations, self.eval_every) if self.eval_every else ()
        return (*due, self.iterations)

    @property
    def iterations(self) -> int:
        """Iterations of `BATCH_STEPS` that make at least `steps`."""
        return -(-self.steps // BATCH_STEPS)
