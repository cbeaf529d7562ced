"""Gymnasium wrappers that put an embedding in front of an agent: z as an observation, or as shaped reward.

Each wrapper has a twin for vector environments, which encodes all states in one call. Arguments are recorded,
so that a wrapped environment's spec can be saved as JSON. `planspace.wrap` chooses the observation wrapper.
"""

from planspace.envs.observation_wrappers import (
    MODES,
    Mode,
    PlanSpaceObservation,
    PlanSpaceVectorObservation,
)
from planspace.envs.shaping_wrappers import PlanSpaceShaping, PlanSpaceVectorShaping

__all__ = [
    "MODES",
    "Mode",
    "PlanSpaceObservation",
    "PlanSpaceShaping",
    "PlanSpaceVectorObservation",
    "PlanSpaceVectorShaping",
]
