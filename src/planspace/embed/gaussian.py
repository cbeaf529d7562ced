"""Diagonal Gaussians: the only family the paper uses for q(z|x) and p(x|z)."""

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

LOG_2_PI = 1.8378770664093453


class DiagonalGaussian(eqx.Module):
    """N(mu, diag(sigma^2))."""

    mu: Float[Array, " dim"]
    sigma: Float[Array, " dim"]

    def sample(self, *, key: Key[Array, ""]) -> Float[Array, " dim"]:
        """A sample through which gradients flow to mu and sigma."""
        return self.mu + self.sigma * jr.normal(key, self.mu.shape)

    def log_prob(self, x: Float[Array, " dim"]) -> Float[Array, ""]:
        """Log N(x; mu, sigma), as a sum of logs so that no product underflows."""
        standardised = (x - self.mu) / self.sigma
        return -jnp.sum(0.5 * standardised**2 + jnp.log(self.sigma) + 0.5 * LOG_2_PI)


def kl(p: DiagonalGaussian, q: DiagonalGaussian) -> Float[Array, ""]:
    """KL(p || q), in closed form."""
    ratio = (p.sigma / q.sigma) ** 2
    shift = ((p.mu - q.mu) / q.sigma) ** 2
    return 0.5 * jnp.sum(ratio + shift - 1.0 - jnp.log(ratio))


def kl_to_prior(p: DiagonalGaussian) -> Float[Array, ""]:
    """KL(p || N(0, 1)), the prior of z."""
    return kl(p, DiagonalGaussian(jnp.zeros_like(p.mu), jnp.ones_like(p.sigma)))
