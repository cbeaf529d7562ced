"""The samples that training draws: triplets of states, as inputs of the encoder."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, Key

from planspace.demos.dataset import Demos
from planspace.embed.config import FitConfig
from planspace.embed.inputs import Inputs
from planspace.embed.objective import PAGE, Objective, title_of
from planspace.embed.triplet_source import Triplets, TripletSource
from planspace.errors import PlanspaceError, UsageError, quoted

WIDER = 1.5
"""States off the demonstrations have a range this many times as wide."""


class Sample(eqx.Module):
    """Three states of a demonstration, x_a, x_t and x_b in this order, and what is known about them."""

    x: Float[Array, "*batch 3 input"]
    """The three states as inputs of the encoder."""
    w: Float[Array, "*batch"]
    """The fraction of the time from a to b that has passed at t."""
    duration: Float[Array, "*batch"]
    """The time from a to b, in mean durations of a demonstration."""
    off_data: Float[Array, "*batch input"]
    """A state off the demonstrations: its numbers come from different demonstrations, in a wider range."""
    control: Float[Array, "*batch control"]
    """The control at a, in standard deviations; empty unless the objective needs controls."""


class Samples(eqx.Module):
    """All states of the demonstrations, and the triplets."""

    inputs: Float[Array, "row input"]
    controls: Float[Array, "row control"]
    """The control at each state, in standard deviations; 0 at the last state of a demonstration."""
    centre: Float[Array, " input"]
    """Mean of the inputs over the training states."""
    columns: Int[Array, " input"]
    """The column of the state that each input comes from."""
    wider: Float[Array, " input"]
    """Factor by which the range of an input is wider off the demonstrations; 1 for sin, cos and rotations."""
    triplets: Int[Array, "triplet 3"]
    w: Float[Array, " triplet"]
    """See `Sample`."""
    duration: Float[Array, " triplet"]
    """See `Sample`."""

    def draw(self, key: Key[Array, ""], batch: int) -> Sample:
        """Draw a batch of samples, with a leading axis."""
        row_key, off_data_key = jr.split(key)
        chosen = jr.randint(row_key, (batch,), 0, len(self.triplets))
        rows = self.triplets[chosen]
        return Sample(
            self.inputs[rows],
            self.w[chosen],
            self.duration[chosen],
            self._off_data(off_data_key, batch),
            self.controls[rows[:, 0]],
        )

    def _off_data(self, key: Key[Array, ""], batch: int) -> Float[Array, "batch input"]:
        """Draw states whose numbers come from different demonstrations, widened about the mean."""
        num_columns = len(
            self.wider
        )  # one draw per input is enough: those of an angle or a rotation share one
        chosen = jr.randint(key, (batch, num_columns), 0, len(self.triplets))
        rows = self.triplets[chosen, 1][:, self.columns]
        values = jnp.take_along_axis(self.inputs, rows, axis=0)
        return self.centre + self.wider * (values - self.centre)


def make_samples(
    demos: Demos, train: Int[np.ndarray, " demo"], inputs: Inputs, config: FitConfig, seed: int
) -> Samples:
    """Prepare the training split for drawing batches.

    Args:
        demos: all demonstrations.
        train: which of them are trained on.
        inputs: what the encoder sees of a state.
        config: how to train.
        seed: seed of the draws before training.

    Raises:
        PlanspaceError: the demonstrations are too short, or have no controls and the objective needs them.
    """
    objective, rng = config.objective, np.random.default_rng(np.random.SeedSequence([seed, 1]))
    source = TripletSource(demos, train, config.spacings, config.short_fraction, rng)
    triplets, times = _checked(objective.draw_triplets(source), len(demos.states))
    mean_duration = np.mean(demos.times[demos.offsets[1:] - 1][train])
    t_a, t_t, t_b = times.T
    wider = [1.0 if on_manifold else WIDER for on_manifold in inputs.on_manifold]
    return Samples(
        inputs=jnp.asarray(inputs(demos.states), dtype=jnp.float32),
        centre=jnp.asarray(inputs(demos.states[demos.rows(train)]).mean(axis=0), dtype=jnp.float32),
        columns=jnp.asarray(inputs.columns),
        wider=jnp.asarray(wider, dtype=jnp.float32),
        controls=jnp.asarray(_controls_of_states(demos, train, objective), dtype=jnp.float32),
        triplets=jnp.asarray(triplets),
        w=jnp.asarray((t_t - t_a) / (t_b - t_a), dtype=jnp.float32),
        duration=jnp.asarray((t_b - t_a) / mean_duration, dtype=jnp.float32),
    )


def _checked(drawn: Any, num_states: int) -> Triplets:
    """Check the triplets that an objective drew."""
    wanted = "the method `draw_triplets` of an Objective must return"
    if not isinstance(drawn, Triplets):
        raise UsageError(f"{wanted} Triplets, got {quoted(drawn)}. See {PAGE}.")
    rows, times = np.asarray(drawn.rows), np.asarray(drawn.times)
    if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows) or times.shape != rows.shape:
        raise UsageError(
            f"{wanted} rows and times of shape (number, 3), got shapes {rows.shape} and {times.shape}. "
            f"See {PAGE}."
        )
    if rows.dtype.kind not in "iu" or rows.min() < 0 or rows.max() >= num_states:
        raise UsageError(f"{wanted} integer rows from 0 to {num_states - 1}, got {quoted(rows)}. See {PAGE}.")
    return Triplets(rows, times)


def _controls_of_states(demos: Demos, train: np.ndarray, objective: Objective) -> np.ndarray:
    if not objective.needs_controls():
        return np.zeros((len(demos.states), 0))
    if demos.info.num_controls == 0:
        raise PlanspaceError(
            f"the objective {title_of(objective)} needs controls, but the demonstrations have none; choose "
            "another objective."
        )
    controls = np.zeros((len(demos.states), demos.info.num_controls))
    last = np.zeros(len(demos.states), dtype=bool)
    last[demos.offsets[1:] - 1] = True
    std = np.concatenate([demos.episode(int(i)).controls for i in train]).std(axis=0)
    controls[~last] = demos.controls / np.where(std > 0, std, 1.0)
    return controls
