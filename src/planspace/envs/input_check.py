"""Warnings for wrappers that read numbers which an embedding was not trained on, such as normalised ones."""

import warnings
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers.vector import NormalizeObservation as VectorNormalizeObservation

from planspace.embed.embedding import Embedding
from planspace.envs.columns import Environment, chain

NUM_STATES, FRACTION = 200, 0.95
"""The first states are checked; a warning follows if at least this fraction is outside the demonstrations."""
CHANGES = ("RescaleObservation", "TransformObservation", "DtypeObservation")
"""Wrappers that may change numbers, and which the warning names."""


class InputCheck:
    """Warns once if nearly all of the first states lie outside the demonstrations of an embedding."""

    def __init__(self, env: Environment, embedding: Embedding, from_observation: bool):
        """Look for `NormalizeObservation` below, and warn if it changes what is read.

        Args:
            env: the environment that the wrapper wraps.
            embedding: the embedding.
            from_observation: whether the states are read from the observation.
        """
        below = list(chain(env)) if from_observation else []
        self._suspects = sorted({type(e).__name__ for e in below if _may_change(e)})
        self._embedding, self._states = embedding, list[np.ndarray]()
        normalised = (gymnasium.wrappers.NormalizeObservation, VectorNormalizeObservation)
        self._done = embedding.support is None
        if any(isinstance(e, normalised) for e in below):
            self._done = True
            warnings.warn(
                "the environment is wrapped in NormalizeObservation, so that the columns of its observation "
                "are normalised, but the embedding reads them in the units of its demonstrations. Wrap the "
                "environment in NormalizeObservation after planspace's wrapper.",
                stacklevel=3,  # what made the wrapper
            )

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Record states until there are enough to judge; return them unchanged."""
        if not self._done:
            self._states.append(np.reshape(states, (-1, self._embedding.state_dim)))
            if sum(map(len, self._states)) >= NUM_STATES:
                self._judge(np.concatenate(self._states))
        return states

    def _judge(self, states: np.ndarray) -> None:
        self._done, self._states = True, []
        if not np.isfinite(states).all():
            return
        outside = self._embedding.outside_support(states).mean()
        if outside < FRACTION:
            return
        known = f" The observation passes through {', '.join(self._suspects)}." if self._suspects else ""
        warnings.warn(
            f"{outside:.0%} of the first {len(states)} states lie outside the demonstrations of the "
            f"embedding, where z is a guess{self._example(states)}.{known} If these numbers are normalised, "
            "or have other units or another order, wrap the environment before they are changed, or give "
            "other `columns`. If they are right, the demonstrations do not cover these states.",
            stacklevel=5,  # what called `step`
        )

    def _example(self, states: np.ndarray) -> str:
        """The column that is most often outside the range of the demonstrations."""
        support, inputs = self._embedding.support, self._embedding.inputs
        assert support is not None
        known = inputs.invert(support.points * support.scale)
        low, high = known.min(axis=0), known.max(axis=0)
        outside = ((states < low) | (states > high)).mean(axis=0)
        if inputs.form == "trig":
            outside[list(inputs.circular_columns)] = 0.0
            for columns in inputs.quaternions:  # both signs are the same rotation
                outside[list(columns)] = 0.0
        column = int(np.argmax(outside))
        if not outside[column]:
            return ""
        seen = states[:, column]
        return (
            f": {inputs.names[column]!r} is between {seen.min():.3g} and {seen.max():.3g} here, and between "
            f"{low[column]:.3g} and {high[column]:.3g} in the demonstrations"
        )


def _may_change(env: Any) -> bool:
    return any(base.__name__ in CHANGES for base in type(env).__mro__) and type(env).__name__ not in (
        "FlattenObservation",
    )
