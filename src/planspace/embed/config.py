"""How an embedding is trained: settings and presets. Imports no JAX, so that `--help` answers at once."""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

from planspace.embed.embedding import InputType
from planspace.errors import UsageError

PresetName = Literal["modern", "paper"]
ObjectiveName = Literal[
    "variational", "direct", "vae", "e2c", "straightening", "distance", "pca", "random", "shuffled"
]
Metric = Literal["l2", "squared", "l1"]

PAPER_SPACINGS = (1, 3, 5, 10, 30)
"""Steps between the members of a triplet (paper, section on the variational embedding)."""
PAPER_HIDDEN = (64, 64)
"""Paper, section on the variational embedding: two hidden layers of 64 units."""


@dataclass(frozen=True)
class ObjectiveConfig:
    """Which objective, and its weights."""

    name: ObjectiveName = "variational"
    """The paper's variational or direct one, or one it is compared with."""
    linearity: float = 8.0
    """lambda of equation 7: the weight of z_t lying on the line from z_a to z_b; the paper has 0.5. For e2c,
    the weight of the predicted z; for straightening, of the curvature."""
    prior: float = 0.1
    """Weight of the KL to the prior; 1 in the paper (below it, beta of Higgins et al. 2017)."""
    double_variance: bool = True
    """Whether z_hat's variance is doubled, to match q(z|x_t) (paper, section on the implementation)."""
    balance: float = 0.5
    """Share of the linearity term's gradient that moves q_t; the rest moves q_a and q_b. 0.5 is plain."""
    curvature: float = 0.0
    """Weight of 1 - cos between z_t - z_a and z_b - z_t, added to the variational objective."""
    distance: float = 0.0
    """Weight of (|z_a - z_b| / s - time between)^2, added to the variational objective; the time is counted
    in mean durations of a demonstration, s is learned."""
    anywhere: float = 1.0
    """Weight of an auto-encoder's bound on states put together from numbers of different demonstrations, in a
    range half as wide again: an agent goes where no plan went, and z should know the state there, too."""
    metric: Metric = "l2"
    """The distance d of equation 2 between states, for the direct objective, over the encoder's inputs."""


@dataclass(frozen=True)
class FitConfig:
    """How an embedding is trained."""

    preset: PresetName = "modern"
    """Where the other fields' values come from."""
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    """What is maximised."""
    columns: tuple[str, ...] = ()
    """Names of the states the encoder reads; none at all reads all of them."""
    z_dim: int = 3
    """Numbers in z; the paper has 3 and 10."""
    inputs: InputType = "trig"
    """`raw` numbers, `standard` for standardised ones, or `trig` with sin and cos of circular angles."""
    hidden: tuple[int, ...] = PAPER_HIDDEN
    """Units of the hidden layers of encoder and decoder."""
    spacings: tuple[int, ...] = ()
    """Steps between the members of a triplet; none at all draws any three states of a demonstration."""
    near: float = 0.5
    """Of how many of those three states the distance is drawn log-uniformly, and so mostly short; the others
    are most of a demonstration apart. Long ones make whole plans straight, short ones keep z of use to a
    policy."""
    sigma_floor: float = 0.2
    """Least deviation of the decoder, in units of its inputs; without it the likelihood runs away."""
    steps: int = 6_000
    """Optimiser steps."""
    batch: int = 512
    """Triplets a step."""
    learning_rate: float = 2e-3
    """Adam's rate at first."""
    decay: bool = True
    """Whether the rate falls to zero by a cosine."""
    clip_norm: float | None = 10.0
    """Gradients are clipped to this norm."""
    average: float = 0.0
    """Decay of a running average of the weights, which then is what is kept; 0 keeps the last ones."""
    z_deviation: float = 2.5
    """z is scaled afterwards so that its dimensions deviate by so much over the training states, in the root
    of their mean square; 0 leaves it as trained, near 1."""
    whitening: float = 0.2
    """How far the principal directions of z are brought to the same deviation afterwards: 0 not at all, 1 all
    the way. It leaves straight lines straight and lets the lesser directions be seen."""

    def __post_init__(self) -> None:
        """Checks the numbers.

        Raises:
            UsageError: one is out of its range; it is named.
        """
        o = self.objective
        weights = (o.linearity, o.prior, o.curvature, o.distance, o.anywhere)
        wrong = [
            (
                min(self.z_dim, self.steps, self.batch, *self.hidden) < 1,
                "z_dim, steps, batch, hidden: 1 or more",
            ),
            (min(self.spacings, default=1) < 1, "spacings: 1 step or more"),
            (not all(0 <= w < math.inf for w in weights), "weights of the objective: 0 or more"),
            (not 0 < self.learning_rate < math.inf, "learning_rate: above 0"),
            (self.clip_norm is not None and not self.clip_norm > 0, "clip_norm: above 0"),
            (not 0 <= self.sigma_floor < math.inf, "sigma_floor: 0 or more"),
            (not 0 <= self.z_deviation < math.inf, "z_deviation: 0 or more"),
            (not 0 <= self.average < 1, "average: from 0 to below 1"),
            (not 0 <= self.near <= 1, "near: from 0 to 1"),
            (not 0 <= o.balance <= 1, "balance: from 0 to 1"),
            (not 0 <= self.whitening <= 1, "whitening: from 0 to 1"),
        ]
        for is_wrong, range_of in wrong:
            if is_wrong:
                raise UsageError(f"how an embedding is trained, {range_of}.")

    def changed(self, **changes: Any) -> "FitConfig":
        """A copy with some fields changed, the objective's by their own names; None leaves a field alone."""
        changes = {k: v for k, v in changes.items() if v is not None}
        names = {f.name for f in fields(ObjectiveConfig)}
        objective = replace(self.objective, **{k: v for k, v in changes.items() if k in names})
        return replace(self, objective=objective, **{k: v for k, v in changes.items() if k not in names})


PRESETS: dict[PresetName, FitConfig] = {
    "modern": FitConfig(),
    "paper": FitConfig(
        preset="paper",
        objective=ObjectiveConfig(linearity=0.5, prior=1.0, anywhere=0.0),
        spacings=PAPER_SPACINGS,
        inputs="raw",
        z_deviation=0.0,
        whitening=0.0,
        sigma_floor=0.0,
        steps=200_000,  # the paper gives no length; the 2020 code took over 9 million
        batch=50,
        learning_rate=1e-3,
        decay=False,
        clip_norm=None,
    ),
}
