"""What training draws from: the inputs made of demonstrations, and the triplets cut out of them."""

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, Key

from planspace.demos.dataset import Demos
from planspace.demos.triplets import random_triplets, triplet_rows
from planspace.embed.config import FitConfig
from planspace.embed.embedding import Inputs
from planspace.embed.objectives import Sample
from planspace.errors import PlanspaceError

WIDER = 1.5
"""How much wider than the demonstrations the states reach that are put together from their numbers."""
NUM_RANDOM = 400_000
"""Triplets of random length drawn before training, from which batches are then taken."""


class Samples(eqx.Module):
    """All states of the demonstrations, and the rows of the triplets."""

    inputs: Float[Array, "row input"]
    controls: Float[Array, "row control"]
    """The control at each state, over its deviation; 0 at the last of a demonstration."""
    centre: Float[Array, " input"]
    """The mean of the inputs over the training states."""
    columns: Int[Array, " input"]
    """The column of the state each input comes from."""
    wider: Float[Array, " input"]
    """How much wider than in the demonstrations an input may be anywhere; 1 for sin and cos."""
    triplets: Int[Array, "triplet 3"]
    w: Float[Array, " triplet"]
    """See `Sample`."""
    duration: Float[Array, " triplet"]
    """See `Sample`."""

    def draw(self, key: Key[Array, ""], batch: int) -> Sample:
        """A batch of triplets, with a leading axis."""
        row_key, anywhere_key = jr.split(key)
        chosen = jr.randint(row_key, (batch,), 0, len(self.triplets))
        rows = self.triplets[chosen]
        return Sample(
            self.inputs[rows],
            self.w[chosen],
            self.duration[chosen],
            self._anywhere(anywhere_key, batch),
            self.controls[rows[:, 0]],
        )

    def _anywhere(self, key: Key[Array, ""], batch: int) -> Float[Array, "batch input"]:
        """States each number of which comes from another demonstration, widened about the mean."""
        num_columns = len(self.wider)  # as many draws as inputs will do: sin and cos share theirs
        chosen = jr.randint(key, (batch, num_columns), 0, len(self.triplets))
        rows = self.triplets[chosen, 1][:, self.columns]
        values = jnp.take_along_axis(self.inputs, rows, axis=0)
        return self.centre + self.wider * (values - self.centre)


def make_samples(
    demos: Demos, train: Int[np.ndarray, " demo"], inputs: Inputs, config: FitConfig, seed: int
) -> Samples:
    """Cuts the training split into what the objective is trained on.

    Args:
        demos: all demonstrations.
        train: which of them are trained on.
        inputs: what the encoder sees of a state.
        config: how to train.
        seed: of triplets of random length, and of shuffling.

    Raises:
        PlanspaceError: the demonstrations are too short, or have no controls where the objective needs them.
    """
    name, rng = config.objective.name, np.random.default_rng(np.random.SeedSequence([seed, 1]))
    if name == "e2c":
        triplets = triplet_rows(demos, train, (1,))  # its dynamics are those of one step
    elif config.spacings:
        triplets = triplet_rows(demos, train, config.spacings)
    else:
        triplets = random_triplets(demos, train, NUM_RANDOM, rng, config.near)
    mean_duration = np.mean(demos.times[demos.offsets[1:] - 1][train])
    t_a, t_t, t_b = demos.times[triplets].T
    if not (t_b > t_a).all():
        raise PlanspaceError("the times of a demonstration do not increase; look at planspace demos show.")
    circles = inputs.circular_columns if inputs.form == "trig" else ()
    wider = [1.0 if c in circles else WIDER for c in inputs.columns]
    if name == "shuffled":
        triplets = shuffle(triplets, rng)
    return Samples(
        inputs=jnp.asarray(inputs(demos.states), dtype=jnp.float32),
        centre=jnp.asarray(inputs(demos.states[demos.rows(train)]).mean(axis=0), dtype=jnp.float32),
        columns=jnp.asarray(inputs.columns),
        wider=jnp.asarray(wider, dtype=jnp.float32),
        controls=jnp.asarray(_controls_of_states(demos, train, name == "e2c"), dtype=jnp.float32),
        triplets=jnp.asarray(triplets),
        w=jnp.asarray((t_t - t_a) / (t_b - t_a), dtype=jnp.float32),
        duration=jnp.asarray((t_b - t_a) / mean_duration, dtype=jnp.float32),
    )


def shuffle(triplets: Int[np.ndarray, "triplet 3"], rng: np.random.Generator) -> Int[np.ndarray, "triplet 3"]:
    """Triplets of the same states, but each member from another triplet: same marginals, no plans."""
    return np.stack([rng.permutation(column) for column in triplets.T], axis=1)


def _controls_of_states(demos: Demos, train: np.ndarray, needed: bool) -> np.ndarray:
    if not needed:
        return np.zeros((len(demos.states), 0))
    if demos.info.num_controls == 0:
        raise PlanspaceError(
            "the objective e2c needs controls, the demonstrations have none; choose another objective."
        )
    controls = np.zeros((len(demos.states), demos.info.num_controls))
    last = np.zeros(len(demos.states), dtype=bool)
    last[demos.offsets[1:] - 1] = True
    deviation = np.concatenate([demos.episode(int(i)).controls for i in train]).std(axis=0)
    controls[~last] = demos.controls / np.where(deviation > 0, deviation, 1.0)
    return controls
