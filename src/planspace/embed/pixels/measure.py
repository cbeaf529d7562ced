"""Measure an encoder of pictures on plans: geometry of z, next to that of z from states."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.embed.geometry import Geometry, measure_each, summarise
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.embed.pixels.stacks import stacks_of_plans
from planspace.physics.pictures import PictureConfig


@dataclass(frozen=True)
class ImageMeasurement:
    """How well z from pictures agrees with z from states, and how straight plans are in each."""

    pixels: Geometry
    """Geometry of z from pictures."""
    states: Geometry
    """Geometry of z from states, on the same states."""
    correlation: Float[np.ndarray, " z"]
    """Correlation of each number of z from pictures with that from states."""
    relative_error: float
    """Root mean square of |z from pictures - z from states|, divided by the standard deviation of z."""
    looks: float
    """Largest distance of a picture from those of the training; see `ImageEncoder.distance`."""

    def summary(self) -> dict[str, float]:
        """The numbers that the artefact keeps."""
        return {
            "z_correlation": float(self.correlation.mean()),
            "z_error": self.relative_error,
            "straightness": self.pixels.straightness,
            "midpoint_error": self.pixels.midpoint_error,
            "time_correlation": self.pixels.time_correlation,
            "decoded_error": self.pixels.decoded_error,
        }


def measure_images(
    encoder: ImageEncoder,
    demos: Demos,
    episodes: Int[np.ndarray, " demo"],
    pictures: PictureConfig | None = None,
) -> ImageMeasurement:
    """Draw plans as an agent would see them, and encode the pictures.

    Args:
        encoder: the encoder.
        demos: the plans; they are resampled to the encoder's time between frames.
        episodes: the plans to measure.
        pictures: other looks than those of the training; None for the encoder's own.

    Raises:
        PlanspaceError: all plans are too short to measure, or nothing can be drawn here.
        UsageError: the demonstrations lack a state that the teacher reads.
    """
    teacher = encoder.teacher
    plans, stacks = stacks_of_plans(demos, episodes, pictures or encoder.pictures, encoder.frame_s)
    plans = plans.select(teacher.inputs.names)
    z, decoded = encoder.read(stacks.images)
    true = teacher.encode(plans.states)
    every, quaternions = np.arange(len(plans)), teacher.inputs.quaternions
    rows = {state.tobytes(): i for i, state in enumerate(plans.states)}

    def rows_of(states: np.ndarray) -> list[int]:
        """`measure_each` leaves out short plans, so the pictures are found by their states."""
        return [rows[state.tobytes()] for state in states]

    seen = measure_each(lambda x: z[rows_of(x)], lambda x: decoded[rows_of(x)], plans, every, quaternions)
    known = measure_each(
        teacher.encode, lambda x: teacher.decode(teacher.encode(x)), plans, every, quaternions
    )
    pairs = zip(z.T, true.T, strict=True)
    return ImageMeasurement(
        pixels=summarise(seen),
        states=summarise(known),
        correlation=np.array([np.corrcoef(a, b)[0, 1] for a, b in pairs]),
        relative_error=float(np.sqrt(((z - true) ** 2).sum(axis=1).mean() / true.var(axis=0).sum())),
        looks=float(encoder.distance(stacks.images).max()),
    )
