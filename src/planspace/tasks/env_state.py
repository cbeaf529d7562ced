"""The planning state of an environment that planspace did not make: its own, or that of its MuJoCo joints.

A reader reads the state, and `write` puts the environment into another one where that is possible.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from jaxtyping import Float

PLAIN_WRAPPERS = (OrderEnforcing, PassiveEnvChecker, TimeLimit)
"""Wrappers of `gymnasium.make` that do not change observations."""


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

    @property
    def can_write(self) -> bool:
        """Whether `write` may work; an environment may ignore the option that it uses."""
        return True

    def write(self, state: Float[np.ndarray, " state"]) -> Any:
        """Start an episode with `reset(options={"state": state})`, and return the observation."""
        return self.env.reset(options={"state": state})[0]


@dataclass(frozen=True)
class JointReader:
    """Reads the positions and velocities of the MuJoCo joints that have names, and the activations.

    The methods `get_env_state` and `set_env_state`, which the Adroit environments have, may add more, such as
    where the door stands.
    """

    env: gymnasium.Env[Any, Any]
    space: Any
    """A `StateSpace`."""
    others: Mapping[str, int] = field(default_factory=dict)
    """Entries of `get_env_state` besides `qpos` and `qvel`, with the number of their values."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each number, as in a planning state, and `KEY_0`, `KEY_1`, ... for the other entries."""
        return (*self.space.names, *(f"{key}_{i}" for key, size in self.others.items() for i in range(size)))

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each number; empty for the other entries."""
        return (*self.space.units, *[""] * sum(self.others.values()))

    def __call__(self) -> Float[np.ndarray, " state"]:
        """Return the current state."""
        found = mujoco_of(self.env)
        assert found is not None
        joints = self.space.read_data(found[1])
        if not self.others:
            return joints
        inner: Any = self.env.unwrapped
        entries = inner.get_env_state()
        return np.concatenate([joints, *(np.ravel(entries[key]) for key in self.others)])

    @property
    def can_write(self) -> bool:
        """Whether the environment has the methods that `write` uses and no joint without a name."""
        inner, found = self.env.unwrapped, mujoco_of(self.env)
        assert found is not None
        model, plain = found[0], _has_plain_wrappers(self.env)
        whole = self.space.size == model.nq + model.nv + self.space.num_activations
        return plain and whole and all(hasattr(inner, name) for name in ("set_state", "_get_obs"))

    def write(self, state: Float[np.ndarray, " state"]) -> Any:
        """Set the state in the current episode, and return the observation."""
        inner, found = self.env.unwrapped, mujoco_of(self.env)
        assert found is not None
        data, size = found[1], self.space.size
        self.space.write_data(state[:size], data)
        qpos, qvel = data.qpos.copy(), data.qvel.copy()
        if self.others:
            ends = np.cumsum(list(self.others.values()))
            values = np.split(np.asarray(state[size:], float), ends[:-1])
            inner.set_env_state({"qpos": qpos, "qvel": qvel, **dict(zip(self.others, values, strict=True))})
        else:
            inner.set_state(qpos, qvel)
        return inner._get_obs()


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

    model, inner = found[0], env.unwrapped
    joints = [model.joint(i).name for i in range(model.njnt) if model.joint(i).name]
    others = {}
    if hasattr(inner, "get_env_state") and hasattr(inner, "set_env_state"):
        entries = inner.get_env_state()
        others = {key: np.size(value) for key, value in entries.items() if key not in ("qpos", "qvel")}
    return JointReader(env, StateSpace.from_model(model, joints), others)


def mujoco_of(env: gymnasium.Env[Any, Any]) -> tuple[Any, Any] | None:
    """Return MuJoCo's model and data in an environment of Gymnasium or dm_control; None if it has none."""
    inner: Any = env.unwrapped
    model = getattr(inner, "model", None)
    if type(model).__name__ == "MjModel":
        return model, inner.data
    physics = getattr(inner, "physics", None)  # dm_control's, which wraps both
    model = getattr(getattr(physics, "model", None), "ptr", None)
    return (model, physics.data.ptr) if physics and type(model).__name__ == "MjModel" else None


def _has_plain_wrappers(env: gymnasium.Env[Any, Any]) -> bool:
    """Whether no wrapper changes the observation."""
    while isinstance(env, gymnasium.Wrapper):
        if not isinstance(env, PLAIN_WRAPPERS):
            return False
        env = env.env
    return True
