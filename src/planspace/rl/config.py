"""Settings of a training run. Imports no JAX, so that `--help` answers at once."""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, get_args

from tyro.conf import arg

from planspace.errors import UsageError, check_setting, unknown
from planspace.rl.algorithm import HOW_TO, Algorithm
from planspace.rl.algorithms.trpo import TRPO
from planspace.seams import UNSET_IF_ZERO, check_fits, with_settings
from planspace.tasks.observation_types import ObservationType, RewardType

BATCH_STEPS = 4000
"""Steps per iteration and seed of algorithms without a default of their own (the 2020 runs: 20 episodes of
200, or 40 of 100)."""

ZMode = Literal["none", "augment", "replace"]
ZTarget = Literal["both", "policy", "critic"]
ShapingType = Literal["none", "z", "raw"]


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
    reward: RewardType = "dense"
    """`dense`: the task's reward. `sparse`: 1 at the goal, 0 elsewhere. `2020`: the swing-up's reward with
    the mistakes of the 2020 code."""
    shaping: ShapingType = "none"
    """Potential-based reward for approaching the goal, by distance in `z` or between `raw` states. Reported
    returns leave it out."""
    shaping_scale: float = 10.0
    """Shaping return from a mean start to the goal."""
    resets: float = field(default=0.0, metadata=UNSET_IF_ZERO)
    """Fraction of the training episodes that start at states of plans. Evaluations always start as the task
    says."""
    replay: float = field(default=0.0, metadata=UNSET_IF_ZERO)
    """Fraction of each minibatch that consists of transitions along plans; for algorithms with a replay
    buffer."""
    num_seeds: Annotated[int, arg(aliases=("--seeds",))] = 5
    """Number of seeds."""
    seed: int = 0
    """The first seed; the others follow it."""
    steps: int = 960_000
    """Environment steps per seed, rounded up to whole iterations."""
    batch_steps: int = 0
    """Environment steps per iteration and seed, rounded to whole episodes. 0: the algorithm's default, which
    is 1000 for SAC and 4000 for other algorithms."""
    eval_every: int = 25
    """Iterations between evaluations with deterministic episodes; 0 evaluates only at the end."""

    def __post_init__(self) -> None:
        """Check names and sizes.

        Raises:
            UsageError: the algorithm is no `Algorithm`, a name is unknown, a number is out of its range, or
                `z_to` is given without z.
        """
        check_fits(self.algorithm, Algorithm, HOW_TO)
        if self.batch_steps == 0:
            object.__setattr__(self, "batch_steps", default_batch_steps(self.algorithm))
        names = {
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
            raise UsageError(f"z_to is {self.z_to!r}, but there is no z: set z to augment or replace.")
        scale = self.shaping_scale
        check_setting("shaping_scale", scale, 0 < scale < math.inf, "above 0 and finite")
        for name in ("resets", "replay"):
            check_setting(name, getattr(self, name), 0 <= getattr(self, name) <= 1, "between 0 and 1")
        for least, names in enumerate((("seed", "eval_every"), ("num_seeds", "steps", "batch_steps"))):
            for name in names:
                check_setting(name, getattr(self, name), getattr(self, name) >= least, f"at least {least}")

    @property
    def needs_embedding(self) -> bool:
        """Whether z is observed or used for shaping."""
        return self.z != "none" or self.shaping == "z"

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
