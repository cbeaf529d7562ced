"""Principal components, to compare with."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from planspace.embed.objective import Embedding, Inputs, Key, Loss, Objective, PlanSpaceModel, Sample


@dataclass(frozen=True)
class PrincipalComponents(Objective):
    """The first principal components of the encoder's inputs; computed in closed form."""

    name: ClassVar[str] = "pca"

    def closed_form(self, inputs: Inputs, states: Float[np.ndarray, "row state"], z_dim: int) -> Embedding:
        """Compute the principal components of the training states."""
        from planspace.embed.principal import principal_components

        return principal_components(inputs, states, z_dim)

    def loss(self, model: PlanSpaceModel, sample: Sample, *, key: Key) -> Loss:
        """Not used."""
        raise NotImplementedError("principal components are computed in closed form")
