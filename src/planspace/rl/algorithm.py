"""The seam of reinforcement learning: what an algorithm is. Imports no JAX, so that `--help` answers at once.

Training calls an algorithm once an iteration:

    states = [algorithm.init(arm, key=...) for each seed]
    repeat: rollout = algorithm.collect(arm, states, rngs)                     # all seeds at once
            states[i], numbers = algorithm.update(arm, states[i], rollout of seed i, key=...)
            network = algorithm.act(arm, states[i])                            # to evaluate and to save

Everything else is written once, in `training`: checkpoints, history, evaluation, saved policies, and freezing
a seed whose numbers are no longer finite. On-policy, off-policy and derivative-free algorithms differ in what
their state holds (a critic, a replay buffer, a population) and in what `update` does with the rollout.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    from jax import Array as Key

    from planspace.rl.arm import Arm
    from planspace.rl.policy_network import PolicyNetwork
    from planspace.rl.rollout import Rollout
else:  # these modules import JAX or MuJoCo
    Key = Arm = PolicyNetwork = Rollout = Any

HOW_TO = "docs/howto/own-algorithm.md"
"""The page that explains the protocol."""


class Diverged(Exception):
    """Raised by `Algorithm.update` when its numbers are no longer finite.

    Training then keeps the state that the seed had, freezes it and goes on with the other seeds.
    """


@runtime_checkable
class Algorithm(Protocol):
    """A reinforcement learning algorithm.

    An implementation is a frozen dataclass whose fields are its hyper-parameters. Its state is any JAX tree
    (nested tuples, dicts, `equinox` modules) of arrays, one tree per seed. Every array keeps its shape and
    type during training and holds finite numbers only.

    An algorithm with the class attribute `replays = True` takes the fraction `arm.config.replay` of each
    minibatch from `arm.plan_transitions`, if it is not None. Training refuses `replay` for any other one.
    One with the class attribute `clones = True` has the method `clone(arm, state, *, key)`, which returns the
    state of a seed after `arm.config.clone` gradient steps that bring the policy's mean action to the actions
    in `arm.plan_transitions`. While `arm.clone_weight` is above 0, its update adds the mean squared error of
    the mean action with this weight to the policy's loss. Training refuses `clone` and `clone_weight` for any
    other algorithm.
    The attributes `batch_steps` and `steps_a_second` give the default steps of an iteration and the speed
    from which studies estimate durations.
    """

    def init(self, arm: Arm, *, key: Key) -> Any:
        """Return the state of one seed before training.

        Args:
            arm: what is trained on; its `num_policy_obs` and `num_actions` are the sizes of a policy.
            key: random key of the seed.
        """
        ...

    def collect(self, arm: Arm, states: Sequence[Any], rngs: Sequence[np.random.Generator]) -> Rollout:
        """Play the episodes of one iteration, for all seeds at once.

        Usually this is one call of `arm.rollout`.

        Args:
            arm: what is trained on.
            states: the state of each seed.
            rngs: the random stream of each seed for this iteration.
        """
        ...

    def update(self, arm: Arm, state: Any, rollout: Rollout, *, key: Key) -> tuple[Any, Mapping[str, float]]:
        """Improve the state of one seed.

        Args:
            arm: what is trained on.
            state: the state of the seed.
            rollout: the episodes of the seed, without the axis of seeds.
            key: random key of the seed and iteration.

        Returns:
            The new state, with the same structure, and numbers for the history, always under the same names.

        Raises:
            Diverged: the numbers are no longer finite.
        """
        ...

    def act(self, arm: Arm, state: Any) -> PolicyNetwork:
        """Return the network that acts for one seed without exploration.

        Training evaluates it and saves it as plain arrays; `load_policy` and `planspace play` read it without
        this algorithm. Its inputs are the `arm.num_policy_obs` numbers that the policy observes, its outputs
        the actions, which are clipped to the limits of the controls.
        """
        ...
