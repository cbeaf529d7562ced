"""Gymnasium environments of the tasks; importing planspace registers the shipped ones."""

from gymnasium.envs.registration import register, registry

from planspace.tasks.catalog import TASKS, add_task
from planspace.tasks.task import Task


def register_tasks() -> None:
    """Register every task under its Gymnasium id."""
    for task in TASKS.values():
        if task.env_id and task.env_id not in registry:
            register(
                task.env_id,
                entry_point="planspace.envs.task:TaskEnv",
                vector_entry_point="planspace.envs.vector:TaskVectorEnv",
                max_episode_steps=task.horizon,
                kwargs={"task": task.name},
            )


def register_task(task: Task) -> None:
    """Register a task of your own, so that `gymnasium.make(task.env_id)` makes it in this process.

    Raises:
        UsageError: another task has its name.
    """
    add_task(task)
    register_tasks()
