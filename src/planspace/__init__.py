"""State embeddings in which demonstrated plans are straight lines, for reinforcement learning."""

__version__ = "0.1.0"

from planspace.demos.dataset import Demos, load_demos
from planspace.embed.embedding import Embedding, load_embedding
from planspace.envs import register_tasks
from planspace.errors import PartialResult, PlanspaceError, UsageError

register_tasks()

__all__ = [
    "Demos",
    "Embedding",
    "PartialResult",
    "PlanspaceError",
    "UsageError",
    "load_demos",
    "load_embedding",
]
