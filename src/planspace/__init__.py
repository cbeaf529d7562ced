"""State embeddings in which demonstrated plans are straight lines, for reinforcement learning.

The public names below are imported when they are first used, so that `import planspace` brings neither JAX
nor MuJoCo: an embedding in someone's worker process needs neither.
"""

__version__ = "0.2.0"

import importlib
from typing import TYPE_CHECKING, Any

from planspace.envs import register_tasks

if TYPE_CHECKING:
    from planspace.control.config import ControlConfig as ControlConfig
    from planspace.control.controller import Controller as Controller
    from planspace.demos.dataset import Demos as Demos
    from planspace.demos.load import load_demos as load_demos
    from planspace.embed.config import FitConfig as FitConfig
    from planspace.embed.embedding import Embedding as Embedding
    from planspace.embed.fit import fit_embedding as fit_embedding
    from planspace.embed.jax_function import jax_function as jax_function
    from planspace.embed.measurement import Measurement as Measurement
    from planspace.embed.measurement import measure_embedding as measure_embedding
    from planspace.embed.objective import Objective as Objective
    from planspace.embed.pixels.config import ImageFitConfig as ImageFitConfig
    from planspace.embed.pixels.config import PictureSpaceConfig as PictureSpaceConfig
    from planspace.embed.pixels.encoder import ImageEncoder as ImageEncoder
    from planspace.embed.pixels.fit import fit_image_encoder as fit_image_encoder
    from planspace.embed.pixels.saved import load_image_encoder as load_image_encoder
    from planspace.embed.saved_embedding import load_embedding as load_embedding
    from planspace.embed.torch_module import torch_module as torch_module
    from planspace.envs.make import make_env as make_env
    from planspace.envs.make import wrap as wrap
    from planspace.errors import PartialResult as PartialResult
    from planspace.errors import PlanspaceError as PlanspaceError
    from planspace.errors import UsageError as UsageError
    from planspace.physics.pictures import PictureConfig as PictureConfig
    from planspace.plan.config import PlanConfig as PlanConfig
    from planspace.plan.demonstrations import plan_demos as plan_demos
    from planspace.rl.config import TrainConfig as TrainConfig
    from planspace.rl.saved_policy import Policy as Policy
    from planspace.rl.saved_policy import load_policy as load_policy
    from planspace.rl.trained import TrainedPolicies as TrainedPolicies
    from planspace.rl.training import train_policies as train_policies
    from planspace.storage.hub import pull_from_hub as pull_from_hub
    from planspace.storage.hub import push_to_hub as push_to_hub
    from planspace.tasks.gymnasium import GymTask as GymTask
    from planspace.tasks.problem import Problem as Problem
    from planspace.tasks.problem_file import load_problem as load_problem
    from planspace.tasks.task import Task as Task

_MODULE_OF = {
    "ControlConfig": "planspace.control.config",
    "Controller": "planspace.control.controller",
    "Demos": "planspace.demos.dataset",
    "Embedding": "planspace.embed.embedding",
    "FitConfig": "planspace.embed.config",
    "ImageEncoder": "planspace.embed.pixels.encoder",
    "ImageFitConfig": "planspace.embed.pixels.config",
    "GymTask": "planspace.tasks.gymnasium",
    "Measurement": "planspace.embed.measurement",
    "Objective": "planspace.embed.objective",
    "PartialResult": "planspace.errors",
    "PictureConfig": "planspace.physics.pictures",
    "PictureSpaceConfig": "planspace.embed.pixels.config",
    "PlanConfig": "planspace.plan.config",
    "PlanspaceError": "planspace.errors",
    "Policy": "planspace.rl.saved_policy",
    "Problem": "planspace.tasks.problem",
    "Task": "planspace.tasks.task",
    "TrainConfig": "planspace.rl.config",
    "TrainedPolicies": "planspace.rl.trained",
    "UsageError": "planspace.errors",
    "fit_embedding": "planspace.embed.fit",
    "fit_image_encoder": "planspace.embed.pixels.fit",
    "jax_function": "planspace.embed.jax_function",
    "load_demos": "planspace.demos.load",
    "load_embedding": "planspace.embed.saved_embedding",
    "load_image_encoder": "planspace.embed.pixels.saved",
    "load_policy": "planspace.rl.saved_policy",
    "load_problem": "planspace.tasks.problem_file",
    "make_env": "planspace.envs.make",
    "measure_embedding": "planspace.embed.measurement",
    "plan_demos": "planspace.plan.demonstrations",
    "pull_from_hub": "planspace.storage.hub",
    "push_to_hub": "planspace.storage.hub",
    "torch_module": "planspace.embed.torch_module",
    "train_policies": "planspace.rl.training",
    "wrap": "planspace.envs.make",
}

__all__ = list(_MODULE_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name from its module."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})


register_tasks()
