"""What a training run is made of: its settings with their algorithm, and the embedding of each seed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from planspace.embed.embedding import Embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.errors import UsageError
from planspace.rl.algorithm import Algorithm
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig, default_batch_steps
from planspace.rl.plans import Plans
from planspace.seams import plain_settings
from planspace.storage.provenance import Provenance
from planspace.tasks.gymnasium import AnyTask
from planspace.tasks.stored_task import task_content


def with_algorithm(config: TrainConfig, algorithm: Algorithm | str | None) -> TrainConfig:
    """The settings with another algorithm, if there is one, and its default of `batch_steps`."""
    if algorithm is None:
        return config
    new = find_algorithm(algorithm) if isinstance(algorithm, str) else algorithm
    is_default = config.batch_steps == default_batch_steps(config.algorithm)
    return replace(config, algorithm=new, batch_steps=0 if is_default else config.batch_steps)


def as_embeddings(
    given: Embedding | str | Path | Sequence[Embedding | str | Path] | None,
) -> tuple[Embedding, ...]:
    """The embeddings that were given, as they are or by folder or name.

    Raises:
        PlanspaceError: an embedding cannot be loaded.
        UsageError: something is neither an embedding nor the path of one.
    """
    if given is None:
        return ()
    each = (given,) if isinstance(given, Embedding | str | Path) else tuple(given)
    return tuple(one if isinstance(one, Embedding) else load_embedding(one) for one in each)


def embedding_of_seeds(embeddings: tuple[Embedding, ...], config: TrainConfig) -> tuple[Embedding, ...]:
    """The embedding of each seed; one embedding if all seeds share it.

    Raises:
        UsageError: nothing uses an embedding, or there are more of them than seeds.
    """
    if embeddings and not config.needs_embedding:
        raise UsageError(
            "an embedding was given, but z is 'none': give --z augment, --z replace, --reward progress, "
            "--shaping time or --shaping z."
        )
    if len(embeddings) <= 1:
        return embeddings
    if len(embeddings) > config.num_seeds:
        raise UsageError(f"{len(embeddings)} embeddings are too many for {config.num_seeds} seeds.")
    return tuple(embeddings[seed % len(embeddings)] for seed in config.seeds)


def run_settings(
    task: AnyTask, config: TrainConfig, embeddings: tuple[Embedding, ...], plans: Plans | None
) -> dict[str, Any]:
    """The content of `config.json`; `read_settings` reads it."""
    return {
        "task": task.name,
        **task_content(task),
        **plain_settings(config),
        "embeddings": [embedding.hash for embedding in embeddings],
        **({} if plans is None else {"plans": plans.hash}),
        "versions": Provenance.current("mujoco", "jax").plain() | task.versions,
    }
