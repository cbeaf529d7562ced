"""A stranger's objectives: a function and a class. Nothing in planspace knows of them."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from planspace.embed.objective import Objective
from planspace.embed.triplet_source import Triplets, TripletSource


def midpoint_loss(model, sample, *, key):
    """The distance between x_t and the state decoded from the point between z_a and z_b."""
    x_a, x_t, x_b = sample.x
    z = (1 - sample.w) * model.encode(x_a).mu + sample.w * model.encode(x_b).mu
    return jnp.sqrt(jnp.sum((model.decode(z).mu - x_t) ** 2) + 1e-6)


@dataclass(frozen=True)
class Contrast(Objective):
    """States one step apart are close in z; states of a random pair are at least `margin` apart."""

    margin: float = 3.0
    """Smallest distance in z of a random pair that costs nothing."""

    def draw_triplets(self, source: TripletSource) -> Triplets:
        """Two neighbours, and the state after them."""
        return source.spaced((1,))

    def loss(self, model, sample, *, key):
        """A pull on neighbours, a push on a state off the demonstrations."""
        z_a, z_t = (
            model.encode(x).sample(key=k) for x, k in zip(sample.x, jax.random.split(key), strict=False)
        )
        z_far = model.encode(sample.off_data).mu
        pull = jnp.sum((z_a - z_t) ** 2)
        push = jnp.maximum(0.0, self.margin - jnp.sqrt(jnp.sum((z_a - z_far) ** 2) + 1e-6)) ** 2
        return pull + push, {"pull": pull, "push": push}


contrast = Contrast()
