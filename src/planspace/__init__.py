"""State embeddings in which demonstrated plans are straight lines, for reinforcement learning."""

__version__ = "0.1.0"

from typing import TYPE_CHECKING, Any

from planspace.embed.embedding import Embedding, load_embedding
from planspace.envs import register_tasks
from planspace.errors import PartialResult, PlanspaceError, UsageError

if TYPE_CHECKING:
    from planspace.demos.dataset import Demos
    from planspace.demos.folder import load_demos
    from planspace.rl.saved_policy import Policy, load_policy

register_tasks()

__all__ = [
    "Demos",
    "Embedding",
    "PartialResult",
    "PlanspaceError",
    "Policy",
    "UsageError",
    "load_demos",
    "load_embedding",
    "load_policy",
]


def __getattr__(name: str) -> Any:
    """Demonstrations bring MuJoCo with them, which an embedding in someone's worker can do without."""
    if name == "Demos":
        from planspace.demos.dataset import Demos

        return Demos
    if name == "load_demos":
        from planspace.demos.folder import load_demos

        return load_demos
    if name in ("Policy", "load_policy"):
        from planspace.rl import saved_policy

        return getattr(saved_policy, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
