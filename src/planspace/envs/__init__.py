"""Environments; importing planspace registers its tasks with Gymnasium."""

from gymnasium.envs.registration import register, registry

from planspace.tasks import TASKS


def register_tasks() -> None:
    """Registers every task under its Gymnasium name."""
    for task in TASKS.values():
        if task.env_id not in registry:
            register(
                task.env_id,
                entry_point="planspace.envs.task:TaskEnv",
                max_episode_steps=task.horizon,
                kwargs={"task": task.name},
            )
