"""Episodes under a controller in worker processes, each on one core."""

import pickle
import warnings
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from planspace.control.config import ControlConfig
from planspace.control.controller import Controller
from planspace.control.episodes import ControlledEpisode, run_episode
from planspace.control.plant import Plant
from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.embed.pixels.sight import Sight, check_sight
from planspace.errors import PlanspaceError
from planspace.workers import WORKER_ENVIRONMENT, WorkerDied, WorkerPool, count_cores, pack


@dataclass(frozen=True)
class Setup:
    """The plant, and all that its controller needs."""

    plant: Plant
    embedding: Embedding | None
    """Computes z."""
    config: ControlConfig
    """How the controller looks ahead."""
    encoder: ImageEncoder | None = None
    """Estimates the state from pictures; None shows the controller the true state."""
    plans: Demos | None = None
    """What the setting `follow_s` follows."""

    def check(self) -> None:
        """Check that all fit together, before anything is written.

        Raises:
            UsageError: they do not.
        """
        if self.encoder is not None:
            check_sight(self.encoder, self.plant.space, self.plant.control_step)
        self.controller()

    def controller(self) -> Controller:
        """Make the controller."""
        with warnings.catch_warnings(action="ignore"):  # of a far goal, which the command has said
            return Controller(self.plant, self.embedding, self.config, plans=self.plans, threads=1)

    def sight(self) -> Sight | None:
        """Make what the controller sees; None if it sees the true state."""
        plant = self.plant
        if self.encoder is None:
            return None
        return Sight(self.encoder, plant.model, plant.space, plant.control_step)

    def packed(self) -> bytes:
        """What a worker process unpacks."""
        plans = None if self.plans is None else replace(self.plans, trees=())  # large, and not followed
        return pack(replace(self, plans=plans))


def control_all(
    setup: Setup,
    seed: int,
    indices: Sequence[int],
    num_steps: int,
    workers: int | None,
    starts: Float[np.ndarray, "episode state"] | None = None,
) -> Generator[ControlledEpisode, None, None]:
    """Run episodes and yield them in order.

    Args:
        setup: what controls them.
        seed: seed of starts, goals and samples.
        indices: numbers of the episodes.
        num_steps: control steps of an episode.
        workers: number of processes; 0 for this one, None for one for each CPU.
        starts: the start of each episode; by default the task draws them.
    """
    start = (lambda i: None) if starts is None else starts.__getitem__
    if workers == 0:
        controller, sight = setup.controller(), setup.sight()
        for i in indices:
            yield run_episode(controller, seed, i, num_steps, sight, start(i))
        return
    packed = setup.packed()
    with WorkerPool(min(workers or count_cores(), len(indices)), WORKER_ENVIRONMENT) as pool:
        futures = [pool.submit(_run_packed, packed, seed, i, num_steps, start(i)) for i in indices]
        try:
            for future in futures:
                yield future.result()
        except WorkerDied as error:
            raise PlanspaceError(
                f"a worker process ended unexpectedly ({error}) during an episode."
            ) from error


def _run_packed(
    packed: bytes, seed: int, index: int, num_steps: int, start: Float[np.ndarray, " state"] | None
) -> ControlledEpisode:
    controller, sight = _unpacked(packed)
    return run_episode(controller, seed, index, num_steps, sight, start)


@lru_cache(maxsize=1)
def _unpacked(packed: bytes) -> tuple[Controller, Sight | None]:
    setup: Setup = pickle.loads(packed)
    return setup.controller(), setup.sight()
