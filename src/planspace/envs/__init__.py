"""Environments; importing planspace registers its tasks with Gymnasium."""

from gymnasium.envs.registration import register, registry

ENVIRONMENTS = {
    "planspace/CartPole-v0": ("cartpole", 100),
    "planspace/CartPoleSwingUp-v0": ("cartpole-swingup", 200),
    "planspace/ReacherTrig-v0": ("reacher-trig", 100),
    "planspace/ReacherRaw-v0": ("reacher-raw", 100),
    "planspace/PendulumSwingUp-v0": ("pendulum-swingup", 200),
    "planspace/AcrobotSwingUp-v0": ("acrobot-swingup", 300),
    "planspace/QuadrotorPlanar-v0": ("quadrotor-planar", 150),
    "planspace/Quadrotor-v0": ("quadrotor", 150),
    "planspace/Arm-v0": ("arm", 150),
}
"""For each name in Gymnasium, the task and its horizon, as in `tasks`, which brings MuJoCo with it."""


def register_tasks() -> None:
    """Registers every task under its Gymnasium name."""
    for env_id, (task, horizon) in ENVIRONMENTS.items():
        if env_id not in registry:
            register(
                env_id,
                entry_point="planspace.envs.task:TaskEnv",
                vector_entry_point="planspace.envs.vector:TaskVectorEnv",
                max_episode_steps=horizon,
                kwargs={"task": task},
            )
