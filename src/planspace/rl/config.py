"""Settings of a training run. Imports no JAX, so that `--help` answers at once."""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

from tyro.conf import arg

from planspace.errors import UsageError, check_setting
from planspace.rl.algorithm import HOW_TO, Algorithm
from planspace.rl.algorithms.trpo import TRPO
from planspace.seams import UNSET_IF_ZERO, check_field_types, check_fits, unset_if, with_settings
from planspace.tasks.observation_types import ObservationType, RewardType

BATCH_STEPS = 4000
"""Steps per iteration and seed of algorithms without a default of their own (the 2020 runs: 20 episodes of
200, or 40 of 100)."""

MOST_SEEDS = 2**32
"""JAX takes seeds modulo this number."""

ZMode = Literal["none", "augment", "replace"]
ZTarget = Literal["both", "policy", "critic"]
ShapingType = Literal["none", "z", "raw", "time"]
GoalMode = Literal["raw", "z"]
TrainReward = Literal["dense", "sparse", "2020", "progress"]
ResetStates = Literal["plans", "trees", "both"]
ResetSchedule = Literal["uniform", "reverse"]


@dataclass(frozen=True)
class TrainConfig:
    """Settings of a training run: algorithm, observations, rewards and seeds."""

    algorithm: Algorithm = TRPO()  # noqa: RUF009 (frozen)
    """The algorithm with its hyper-parameters."""
    obs: ObservationType = "raw"
    """`raw`: the state as it is. `wrapped`: angles on a circle within (-pi, pi]. `trig`: raw, and sin and cos
    of its angles."""
    z: ZMode = "none"
    """`none`; `augment`: append z to the observation; `replace`: observe z only."""
    z_to: ZTarget = "both"
    """Which networks observe z."""
    goal: GoalMode = field(default="raw", metadata=unset_if("raw"))
    """`raw`: goals are observed as the task shows them. `z`: z is followed by z of the goal, the direction
    from the one to the other as a unit vector, and their distance."""
    reward: TrainReward = "dense"
    """`dense`: the task's reward. `sparse`: 1 at the goal, 0 elsewhere. `2020`: the swing-up's reward with
    the mistakes of the 2020 code. `progress`: the estimated time to the goal that a step saves [s]; reported
    returns are those of `dense`."""
    shaping: ShapingType = "none"
    """Potential-based reward for approaching the goal, by distance in `z`, distance between `raw` states, or
    the embedding's estimate of the `time` to the goal. Reported returns leave it out."""
    shaping_scale: float = 10.0
    """Shaping return from a mean start to the goal."""
    resets: float = field(default=0.0, metadata=UNSET_IF_ZERO)
    """Fraction of the training episodes that start at states of plans. Evaluations always start as the task
    says."""
    reset_states: ResetStates = field(default="plans", metadata=unset_if("plans"))
    """Where the episodes of `resets` start: at states of `plans`, of the search `trees` that were kept with
    them, or, half of the episodes each, of `both`."""
    reset_schedule: ResetSchedule = field(default="uniform", metadata=unset_if("uniform"))
    """`uniform`: at states of whole plans. `reverse`: at the last tenth of each plan at first, then from ever
    earlier states on; in the second half of training, as `uniform`."""
    replay: float = field(default=0.0, metadata=UNSET_IF_ZERO)
    """Fraction of each minibatch that consists of transitions along plans; for algorithms with a replay
    buffer."""
    plan_noise: float = field(default=0.0, metadata=UNSET_IF_ZERO)
    """Standard deviation of noise that moves states off the plans, as a fraction of that of all states of the
    plans. With it, `replay`, `clone` and `clone_weight` also get steps from such states, with the control of
    a linear regulator that leads back to the plan, or in a Gymnasium environment with position servos, with
    the control of the plan."""
    clone: int = field(default=0, metadata=UNSET_IF_ZERO)
    """Gradient steps before training that bring the policy's mean action to the controls of plans. With them,
    standardised observations are standardised by the plans throughout training."""
    clone_weight: float = field(default=0.0, metadata=UNSET_IF_ZERO)
    """Weight of a penalty in the policy's loss: the squared difference of its mean action from the controls
    of plans."""
    clone_decay: float = field(default=0.5, metadata=unset_if(0.5))
    """Fraction of training over which the penalty decreases linearly to 0."""
    num_seeds: Annotated[int, arg(aliases=("--seeds",))] = 5
    """Number of seeds."""
    seed: int = 0
    """The first seed; the others follow it."""
    steps: int = 960_000
    """Environment steps per seed, rounded up to iterations of `batch_steps`, which are then rounded to whole
    episodes."""
    batch_steps: int = 0
    """Environment steps per iteration and seed, rounded to whole episodes. 0: the algorithm's default, which
    is 1000 for SAC and 4000 for other algorithms."""
    action_repeat: int = field(default=1, metadata=unset_if(1))
    """Environment steps for which each action is held; their rewards are summed. `steps` and `batch_steps`
    count environment steps."""
    eval_every: int = 25
    """Iterations between evaluations with deterministic episodes; 0 evaluates only at the end."""

    def __post_init__(self) -> None:
        """Check names and sizes.

        Raises:
            UsageError: the algorithm is no `Algorithm`, a name is unknown, a number is out of its range, or
                `z_to` is given without z.
        """
        check_fits(self.algorithm, Algorithm, HOW_TO)
        check_field_types(self)
        if self.batch_steps == 0:
            object.__setattr__(self, "batch_steps", default_batch_steps(self.algorithm))
        if self.z == "none" and self.z_to != "both":
            raise UsageError(f"z_to is {self.z_to!r}, but there is no z: set z to augment or replace.")
        if self.z == "none" and self.goal == "z":
            raise UsageError("goal is 'z', but there is no z: set z to augment or replace.")
        if self.reward == "progress" and self.shaping != "none":
            raise UsageError("the reward 'progress' is paid instead of shaping rewards: leave out shaping.")
        scale = self.shaping_scale
        check_setting("shaping_scale", scale, 0 < scale < math.inf, "above 0 and finite")
        for name in ("resets", "replay"):
            check_setting(name, getattr(self, name), 0 <= getattr(self, name) <= 1, "between 0 and 1")
        self._check_uses_of_plans()
        for least, names in enumerate(
            (("seed", "eval_every", "clone"), ("num_seeds", "steps", "batch_steps", "action_repeat"))
        ):
            for name in names:
                check_setting(name, getattr(self, name), getattr(self, name) >= least, f"at least {least}")

        most = MOST_SEEDS - self.num_seeds
        check_setting("seed", self.seed, self.seed <= most, f"at most {most}, as JAX knows 2^32 seeds")

    def _check_uses_of_plans(self) -> None:
        """Check the settings of resets and cloning.

        Raises:
            UsageError: a number is out of its range, or a setting has no effect.
        """
        weight, decay = self.clone_weight, self.clone_decay
        check_setting("clone_weight", weight, 0 <= weight < math.inf, "at least 0 and finite")
        noise = self.plan_noise
        check_setting("plan_noise", noise, 0 <= noise < math.inf, "at least 0 and finite")
        if noise and not (self.replay or self.clone or weight):
            raise UsageError(
                f"plan_noise is {noise:g}, but no step along plans is used: set `replay` or `clone`."
            )
        check_setting("clone_decay", decay, 0 < decay <= 1, "above 0 and at most 1")
        for name, default in (("reset_states", "plans"), ("reset_schedule", "uniform")):
            if getattr(self, name) != default and not self.resets:
                raise UsageError(
                    f"{name} is {getattr(self, name)!r}, but no episode starts at plans: set `resets`."
                )
        if self.reset_schedule == "reverse" and self.reset_states != "plans":
            raise UsageError(
                f"reset_schedule 'reverse' needs states of plans, got reset_states {self.reset_states!r}: a "
                "search tree does not say how far a state is from the end of a plan."
            )

    @property
    def uses_of_plans(self) -> tuple[str, ...]:
        """The settings that use plans."""
        return tuple(name for name in ("resets", "replay", "clone", "clone_weight") if getattr(self, name))

    @property
    def needs_embedding(self) -> bool:
        """Whether z is observed, or an embedding is used for rewards."""
        return self.z != "none" or self.shaping in ("z", "time") or self.reward == "progress"

    @property
    def task_reward(self) -> RewardType:
        """The reward that the task computes and that returns consist of."""
        return "dense" if self.reward == "progress" else self.reward

    def with_hyperparameters(self, **changes: Any) -> "TrainConfig":
        """Copy with other hyper-parameters of the algorithm, by the names of its fields."""
        return replace(self, algorithm=with_settings(self.algorithm, **changes))

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
        """Iterations of `batch_steps` that make at least `steps`."""
        return -(-self.steps // self.batch_steps)


def default_batch_steps(algorithm: Algorithm) -> int:
    """The class attribute `batch_steps` of an algorithm, or `BATCH_STEPS` if it has none."""
    return getattr(algorithm, "batch_steps", BATCH_STEPS)
