"""An embedding in front of anyone's agent."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from planspace.embed.embedding import load_embedding
from planspace.errors import UsageError


class PlanSpaceObservation(
    gymnasium.ObservationWrapper[np.ndarray, np.ndarray, np.ndarray], gymnasium.utils.RecordConstructorArgs
):
    """Shows the agent z, the mean of q(z|x): beside the observation, or instead of it."""

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        embedding: str | Path,
        mode: str = "augment",
        columns: Sequence[int] | None = None,
    ):
        """Wraps an environment with a flat Box observation.

        Args:
            env: the environment.
            embedding: the embedding's folder.
            mode: `augment` appends z to the observation, `replace` gives z alone.
            columns: which numbers of the observation make the embedding's state, in its order; by default
                the state is read from the environment's attribute `state`, as planspace's own have it; of
                one that has `state_names`, too, the numbers are taken by name.

        Raises:
            UsageError: the state cannot be read that way or has another size, the observation is not a flat
                Box, or the mode is unknown.
            PlanspaceError: the embedding cannot be loaded.
        """
        gymnasium.utils.RecordConstructorArgs.__init__(
            self, embedding=str(embedding), mode=mode, columns=None if columns is None else list(columns)
        )
        super().__init__(env)
        self.embedding = load_embedding(embedding)
        self._columns = None if columns is None else list(columns)
        self._mode = mode
        space = env.observation_space
        if mode not in ("augment", "replace"):
            raise UsageError(f"mode is 'augment' or 'replace', got {mode!r}.")
        if not isinstance(space, Box) or len(space.shape) != 1:
            raise UsageError(
                f"the observation must be a flat Box, got {space}; wrap FlattenObservation first."
            )
        self._of_state = self._find_state(space.shape[0])
        z = np.full(self.embedding.z_dim, np.inf, dtype=np.float32)
        low, high = (-z, z) if mode == "replace" else (np.append(space.low, -z), np.append(space.high, z))
        self.observation_space = Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)

    def observation(self, observation: np.ndarray) -> np.ndarray:
        """The observation with z."""
        env: Any = self.unwrapped
        source = env.state if self._columns is None else observation
        z = self.embedding.encode(source[self._of_state])
        seen = z if self._mode == "replace" else np.append(observation, z)
        return seen.astype(np.float32)

    def _find_state(self, num_obs: int) -> slice | list[int]:
        """Where the embedding's numbers are in the observation, or in the environment's state."""
        wanted = self.embedding.inputs.names
        if self._columns is None and not hasattr(self.unwrapped, "state"):
            raise UsageError(
                "the environment has no attribute `state` to read; give columns=[...], the numbers of the "
                f"observation that are ({', '.join(wanted)})."
            )
        names = getattr(self.unwrapped, "state_names", None)
        if self._columns is None and names is not None:
            return list(self.embedding.columns_of(names))
        got = len(self._columns) if self._columns is not None else np.size(self.unwrapped.state)  # pyright: ignore
        if got != len(wanted):
            raise UsageError(f"the embedding reads {len(wanted)} numbers ({', '.join(wanted)}), got {got}.")
        if self._columns is not None and not all(0 <= c < num_obs for c in self._columns):
            raise UsageError(f"columns {self._columns} reach outside an observation of {num_obs} numbers.")
        return slice(None) if self._columns is None else self._columns
