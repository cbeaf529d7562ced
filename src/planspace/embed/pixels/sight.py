"""What a camera tells during an episode: z and the state, from the last few pictures."""

import warnings
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from planspace.embed.pixels.encoder import ImageEncoder
from planspace.errors import UsageError
from planspace.physics.pictures import Look, Pictures, stacked
from planspace.physics.space import StateSpace

STRANGE = 1.5
"""Distance from the training pictures above which a warning is given."""
STEP_TOLERANCE = 1e-6


@runtime_checkable
class Filter(Protocol):
    """Joins the estimates of an episode, such as `planspace.plan.state_filter.StateFilter`."""

    def __call__(self, estimate: Float[np.ndarray, " state"]) -> Float[np.ndarray, " state"]:
        """Return the state that all estimates so far suggest."""
        ...

    def predict(self, control: Float[np.ndarray, " control"]) -> None:
        """Take note of the control that is applied next."""
        ...


class Sight:
    """Draws the states of an episode one after another, and encodes the pictures.

    The states are only drawn. Nothing else of them reaches the encoder.
    """

    def __init__(self, encoder: ImageEncoder, model: mujoco.MjModel, space: StateSpace, step_s: float):
        """Open the renderer.

        Args:
            encoder: encodes the pictures.
            model: the compiled model.
            space: its state space.
            step_s: time between two pictures, the control step [s].

        Raises:
            UsageError: the encoder was trained on another time between frames, or estimates other states.
            PlanspaceError: no OpenGL backend works here.
        """
        check_sight(encoder, space, step_s)
        self.encoder = encoder
        self._order = [encoder.teacher.inputs.names.index(name) for name in space.names]
        self._filter: Filter | None = None
        self._pictures = Pictures(model, space, encoder.pictures)
        self._frames: UInt8[np.ndarray, "frame height width 3"] | None = None
        self._look: Look | None = None

    @property
    def state_error(self) -> Float[np.ndarray, " state"] | None:
        """Root-mean-square error of each number of the estimated state, if it is known."""
        error = self.encoder.state_error
        return None if error is None else error[self._order]

    def restart(self, rng: np.random.Generator, state_filter: Filter | None = None) -> None:
        """Begin an episode; the first picture will fill the whole stack.

        Args:
            rng: draws colours and camera, if the encoder was trained with such.
            state_filter: joins the estimates of this episode; None takes each as it is.
        """
        self._frames, self._look = None, self._pictures.draw_look(rng)
        self._filter = state_filter

    def see(
        self, state: Float[np.ndarray, " state"]
    ) -> tuple[Float[np.ndarray, " z"], Float[np.ndarray, " state"]]:
        """Draw the present state, and return z and the state that the pictures so far show.

        With a filter, the state is the filtered one, and z is the teacher's z of it.
        """
        picture = self._pictures.of_states(state[None], self._look)
        is_first = self._frames is None
        if self._frames is None:
            self._frames = picture.repeat(self.encoder.pictures.frames, axis=0)
        else:
            self._frames = np.concatenate([self._frames[1:], picture])
        stack = stacked(self._frames)
        if is_first:
            self._check_looks(stack)
        z, seen = self.encoder.read(stack)
        if self._filter is None:
            return z, seen[self._order]
        filtered = self._filter(seen[self._order])
        seen[self._order] = filtered
        return self.encoder.teacher.encode(seen), filtered

    def applied(self, control: Float[np.ndarray, " control"]) -> None:
        """Take note of the control that is applied until the next picture."""
        if self._filter is not None:
            self._filter.predict(control)

    def close(self) -> None:
        """Free the memory of the graphics library."""
        self._pictures.close()

    def _check_looks(self, stack: np.ndarray) -> None:
        distance = float(self.encoder.distance(stack))
        if distance > STRANGE:
            warnings.warn(
                f"the picture does not look like those of the training: distance {distance:.1f}, at most 1 "
                "in training. Is it another camera, or are there other colours?",
                stacklevel=3,
            )


def check_sight(encoder: ImageEncoder, space: StateSpace, step_s: float) -> None:
    """Check that an encoder fits a robot, before anything is drawn.

    Raises:
        UsageError: it does not.
    """
    if abs(encoder.frame_s - step_s) > STEP_TOLERANCE:
        raise UsageError(
            f"the encoder was trained on frames {encoder.frame_s:g} s apart, but the control step is "
            f"{step_s:g} s: train one with --frame-s {step_s:g}."
        )
    if missing := [name for name in space.names if name not in encoder.teacher.inputs.names]:
        raise UsageError(
            f"the encoder does not estimate {missing[0]!r}: its teacher reads only "
            f"{', '.join(encoder.teacher.inputs.names)}."
        )
