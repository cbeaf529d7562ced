from dataclasses import replace

import gymnasium
import pytest

from planspace.embed.embedding import Embedding
from planspace.envs.wrappers import PlanSpaceObservation, PlanSpaceVectorObservation
from planspace.errors import UsageError


def test_an_embedding_in_degrees_is_refused_by_an_environment_in_radians(embedding: Embedding) -> None:
    degrees = replace(embedding, inputs=replace(embedding.inputs, units=("m", "deg", "m/s", "rad/s")))
    single = gymnasium.make("planspace/CartPoleSwingUp-v0")
    with pytest.raises(UsageError, match="reads 'hinge' in deg, but here it is in rad"):
        PlanSpaceObservation(single, degrees)
    many = gymnasium.make_vec("planspace/CartPoleSwingUp-v0", 2, vectorization_mode="vector_entry_point")
    with pytest.raises(UsageError, match="reads 'hinge' in deg, but here it is in rad"):
        PlanSpaceVectorObservation(many, degrees)
