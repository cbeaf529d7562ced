"""Episodes under a controller in worker processes, each on one core."""

import pickle
import warnings
from collections.abc import Generator
from dataclasses import replace
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


def check_fit(
    plant: Plant,
    embedding: Embedding | None,
    config: ControlConfig,
    encoder: ImageEncoder | None,
    plans: Demos | None,
) -> None:
    """Check that plant, embedding, settings, encoder and plans fit together, before anything is written.

    Raises:
        UsageError: they do not.
    """
    if encoder is not None:
        check_sight(encoder, plant.space, plant.control_step)
    _make_controller(plant, embedding, config, plans)


def control_all(  # noqa: PLR0913
    plant: Plant,
    embedding: Embedding | None,
    config: ControlConfig,
    seed: int,
    indices: range,
    num_steps: int,
    workers: int | None,
    encoder: ImageEncoder | None = None,
    plans: Demos | None = None,
    starts: Float[np.ndarray, "episode state"] | None = None,
) -> Generator[ControlledEpisode, None, None]:
    """Run episodes and yield them in order.

    Args:
        plant: what is controlled.
        embedding: computes z.
        config: how the controller looks ahead.
        seed: seed of starts, goals and samples.
        indices: numbers of the episodes.
        num_steps: control steps of an episode.
        workers: number of processes; 0 for this one, None for one for each CPU.
        encoder: estimates the state from pictures; None shows the controller the true state.
        plans: what `follow_s` follows.
        starts: the start of each episode; by default the task draws them.
    """
    start = (lambda i: None) if starts is None else starts.__getitem__
    if workers == 0:
        controller = _make_controller(plant, embedding, config, plans)
        sight = _make_sight(plant, encoder)
        for i in indices:
            yield run_episode(controller, seed, i, num_steps, sight, start(i))
        return
    plans = None if plans is None else replace(plans, trees=())  # they are large, and not followed
    packed = pack((plant, embedding, config, encoder, plans))
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
    plant, embedding, config, encoder, plans = pickle.loads(packed)
    return _make_controller(plant, embedding, config, plans), _make_sight(plant, encoder)


def _make_sight(plant: Plant, encoder: ImageEncoder | None) -> Sight | None:
    return None if encoder is None else Sight(encoder, plant.model, plant.space, plant.control_step)


def _make_controller(
    plant: Plant, embedding: Embedding | None, config: ControlConfig, plans: Demos | None
) -> Controller:
    with warnings.catch_warnings(action="ignore"):  # of a far goal, which the command has said
        return Controller(plant, embedding, config, plans=plans, threads=1)
