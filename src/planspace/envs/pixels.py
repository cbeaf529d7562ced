"""Pictures as observations: the last frames of each episode, stacked."""

import numpy as np
from jaxtyping import Int, UInt8

from planspace.envs.batch import TaskBatch
from planspace.errors import UsageError, unknown
from planspace.physics.pictures import Look, PictureConfig, Pictures, stacked
from planspace.tasks.observation_types import OBSERVATION_TYPES, ObservationType, find_observation_type

PIXELS = "pixels"


def find_view(obs: str, pictures: PictureConfig | None) -> tuple[ObservationType, PictureConfig | None]:
    """Return the type of the task's own observation, and the settings of pictures if they are observed.

    Args:
        obs: an observation type, or `pixels`.
        pictures: the settings of pictures; None for the defaults.

    Raises:
        UsageError: no observation type has this name, or pictures were described but not asked for.
    """
    if obs == PIXELS:
        return "raw", pictures or PictureConfig()
    if pictures is not None:
        raise UsageError(f"`pictures` describes the observation {PIXELS!r}, got obs={obs!r}.")
    if obs not in OBSERVATION_TYPES:
        raise unknown("observation type", obs, (*OBSERVATION_TYPES, PIXELS))
    return find_observation_type(obs), None


class PixelStacks:
    """The last pictures of each episode of a batch."""

    def __init__(self, batch: TaskBatch, config: PictureConfig):
        """Remember the batch; the renderer opens with the first picture."""
        self.config = config
        self._batch = batch
        self._pictures: Pictures | None = None
        num = len(batch.states)
        self._frames = np.zeros((num, config.frames, config.height, config.width, 3), dtype=np.uint8)
        self._looks: list[Look | None] = [None] * num

    def restart(self, ids: Int[np.ndarray, " env"], rngs: list[np.random.Generator]) -> None:
        """Begin episodes: their first picture fills the whole stack, as in Gymnasium's FrameStackObservation.

        Args:
            ids: the environments.
            rngs: the random streams of these environments, for colours and camera.

        Raises:
            UsageError: the model has no camera of this name.
            PlanspaceError: no OpenGL backend works here.
        """
        for i, rng in zip(ids.tolist(), rngs, strict=True):
            self._looks[i] = self._opened().draw_look(rng)
            self._frames[i] = self._picture(i)

    def push(self, ids: Int[np.ndarray, " env"]) -> None:
        """Add a picture of the present state of some environments, and forget their oldest one."""
        for i in ids.tolist():
            self._frames[i] = np.roll(self._frames[i], -1, axis=0)
            self._frames[i, -1] = self._picture(i)

    def stacks(self) -> UInt8[np.ndarray, "env height width channel"]:
        """The stacks of all environments."""
        return stacked(self._frames)

    def close(self) -> None:
        """Free the memory of the graphics library."""
        if self._pictures is not None:
            self._pictures.close()
        self._pictures = None

    def _opened(self) -> Pictures:
        if self._pictures is None:
            simulator = self._batch.simulator
            self._pictures = Pictures(simulator.model, simulator.space, self.config)
        return self._pictures

    def _picture(self, i: int) -> np.ndarray:
        data = self._batch.mujoco_data(i)
        return self._opened().of_pose(data.qpos, data.mocap_pos, self._looks[i])
