"""The shipped objectives, one per file."""

from planspace.embed.objective import Objective
from planspace.embed.objectives.direct import Direct
from planspace.embed.objectives.distance import Distance
from planspace.embed.objectives.e2c import EmbedToControl
from planspace.embed.objectives.pca import PrincipalComponents
from planspace.embed.objectives.random import RandomEncoder
from planspace.embed.objectives.shuffled import Shuffled
from planspace.embed.objectives.straightening import Straightening
from planspace.embed.objectives.vae import AutoEncoder
from planspace.embed.objectives.variational import Variational

OBJECTIVES: dict[str, Objective] = {
    objective.name: objective
    for objective in (
        Variational(),
        Direct(),
        AutoEncoder(),
        EmbedToControl(),
        Straightening(),
        Distance(),
        PrincipalComponents(),
        RandomEncoder(),
        Shuffled(),
    )
}
"""Each shipped objective by name, with the weights of the preset `modern`."""
