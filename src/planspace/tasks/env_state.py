"""The planning state of an environment that planspace did not make: its own, or that of its MuJoCo joints."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class AttributeReader:
    """Reads the attribute `state` of an environment."""

    env: gymnasium.Env[Any, Any]
    names: tuple[str, ...]
    """Name of each number: the attribute `state_names`."""

    def __call__(self) -> Float[np.ndarray, " state"]:
        """Return the current state."""
        inner: Any = self.env.unwrapped
        return np.asarray(inner.state, dtype=float)


@dataclass(frozen=True)
class JointReader:
    """Reads the positions and velocities of the MuJoCo joints that have names, and the activations."""

    env: gymnasium.Env[Any, Any]
    space: Any
    """A `StateSpace`."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each number, as in a planning state."""
        return self.space.names

    def __call__(self) -> Float[np.ndarray, " state"]:
        """Return the current state."""
        found = mujoco_of(self.env)
        assert found is not None
        return self.space.read_data(found[1])


StateReader = AttributeReader | JointReader


def state_reader(env: gymnasium.Env[Any, Any]) -> StateReader | None:
    """Return what reads the state of an environment, wrapped or not; None if it has no state with names."""
    names = getattr(env.unwrapped, "state_names", None)
    return joint_reader(env) if names is None else AttributeReader(env, tuple(names))


def joint_reader(env: gymnasium.Env[Any, Any]) -> JointReader | None:
    """Return what reads the joints of an environment, wrapped or not; None if it does not use MuJoCo."""
    found = mujoco_of(env)
    if found is None:
        return None
    from planspace.physics.space import StateSpace  # imports MuJoCo, which such an environment has imported

    model = found[0]
    joints = [model.joint(i).name for i in range(model.njnt) if model.joint(i).name]
    return JointReader(env, StateSpace.from_model(model, joints))


def mujoco_of(env: gymnasium.Env[Any, Any]) -> tuple[Any, Any] | None:
    """Return MuJoCo's model and data in an environment of Gymnasium or dm_control; None if it has none."""
    inner: Any = env.unwrapped
    model = getattr(inner, "model", None)
    if type(model).__name__ == "MjModel":
        return model, inner.data
    physics = getattr(inner, "physics", None)  # dm_control's, which wraps both
    model = getattr(getattr(physics, "model", None), "ptr", None)
    return (model, physics.data.ptr) if physics and type(model).__name__ == "MjModel" else None
