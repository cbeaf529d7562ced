"""The paper's direct objective."""

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from planspace.embed.objective import Key, Loss, Objective, PlanSpaceModel, Sample
from planspace.errors import unknown

Metric = Literal["l2", "squared", "l1"]


@dataclass(frozen=True)
class Direct(Objective):
    """The paper's direct encoding: the point between z_a and z_b is decoded to x_t; nothing is sampled."""

    name: ClassVar[str] = "direct"

    metric: Metric = "l2"
    """The distance d between states of equation 2, over the encoder's inputs."""

    def __post_init__(self) -> None:
        """Check the metric.

        Raises:
            UsageError: it is unknown.
        """
        if self.metric not in get_args(Metric):
            raise unknown("metric", self.metric, get_args(Metric))

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """The distance between x_t and the state decoded from the point between z_a and z_b.

        Source: equations 1 and 2. Encoder and decoder are the means.
        """
        import jax.numpy as jnp

        from planspace.embed import losses

        x_a, x_t, x_b = sample.x
        q_mid = losses.between(model.encode(x_a), model.encode(x_b), sample.w, double_variance=True)
        error = model.decode(q_mid.mu).mu - x_t
        if self.metric == "l2":
            return losses.length(error)
        return jnp.sum(error**2) if self.metric == "squared" else jnp.sum(jnp.abs(error))
