"""Many simulations of one model, stepped together on a thread pool.

The physics is MuJoCo's C code through `mujoco.batch`: the results are bit-identical to a loop over `mj_step`
for any number of threads. By default MuJoCo silently resets a state that diverged; our models turn this off
(`autoreset`), and `Simulator.diverged` reads the warning counters.

A kinematic space has no dynamics: a control is the velocity of each degree of freedom, a step moves the
positions along it, and MuJoCo computes only contacts.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from planspace.mjcf.compile import GeomPairs, stepping
from planspace.physics.constraints import Constraints
from planspace.physics.space import StateSpace
from planspace.physics.step_count import count_steps
from planspace.physics.supported import check_supported

_WARNINGS = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),  # MuJoCo then sets all controls to 0
]
_POSITION_STAGE = int(mujoco.mjtStage.mjSTAGE_POS)


@dataclass(frozen=True)
class Validity:
    """Conditions that make a state invalid besides leaving its bounds."""

    forbidden_contacts: Literal["none", "all"] | GeomPairs = "none"
    """Which contacts are forbidden: none, all, or those between the two geoms of each pair."""
    predicate: Callable[[np.ndarray], np.ndarray] | None = None
    """Function from states [batch, state] to whether each is allowed [batch]. Worker processes can only use a
    function that is defined at the top level of a module."""

    @property
    def pairs(self) -> GeomPairs:
        """The pairs of geoms that must not touch; empty if all contacts or none are forbidden."""
        return () if isinstance(self.forbidden_contacts, str) else self.forbidden_contacts


FREE = Validity()
"""Only the bounds make a state invalid."""


class Simulator:
    """Simulations of one model, stepped together."""

    def __init__(
        self,
        model: mujoco.MjModel,
        space: StateSpace,
        num: int,
        *,
        threads: int = 0,
        validity: Validity = FREE,
    ):
        """Make the simulations.

        Args:
            model: the compiled model; `load_model` must have added contact sensors for the pairs of
                `validity`.
            space: state space of the model.
            num: number of simulations.
            threads: number of physics threads; 0 means one per CPU. Results do not depend on it.
            validity: conditions that make an edge invalid besides leaving the bounds.

        Raises:
            UsageError: the model has a hidden state; see `check_supported`.
        """
        if not space.kinematic:
            check_supported(model)
        self.model, self.space, self.num, self.validity = model, space, num, validity
        self.threads = threads
        with stepping():
            self._batch = Batch(model, num, threads)
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._act = self._batch.bind("act")
        self._history = self._batch.bind("history")
        self._time = self._batch.bind("time")
        self._ctrl = self._batch.bind("ctrl")
        self._warmstart = self._batch.bind("qacc_warmstart")
        self._inertia = self._batch.bind("M")
        self._bias, self._passive = self._batch.bind("qfrc_bias"), self._batch.bind("qfrc_passive")
        if validity.forbidden_contacts != "none":
            self._contacts = self._batch.bind("sensordata" if validity.pairs else "ncon")
        self.control_low, self.control_high = control_bounds(model, space)

    @cached_property
    def constraints(self) -> Constraints:
        """What the model requires of a state."""
        return Constraints(self.model, self.space)

    def reset(self, states: Float[np.ndarray, "sim state"], ids: np.ndarray | None = None) -> None:
        """Set the states of all simulations, or of those in `ids`, and clear the solver's warm start."""
        index = slice(None) if ids is None else ids
        qpos, qvel, act = self._qpos[index], self._qvel[index], self._act[index]
        history = self._history[index]
        self.space.write(states, qpos, qvel, act, history)
        self._qpos[index], self._qvel[index], self._act[index] = qpos, qvel, act
        if self.space.activations.delays.size:
            self._history[index], self._time[index] = history, 0.0
        self._warmstart[index] = 0.0
        self._batch.warning[index] = 0

    def step(
        self, controls: Float[np.ndarray, "sim control"], num_steps: int = 1, ids: np.ndarray | None = None
    ) -> None:
        """Apply each control, clipped to its bounds, for a number of physics steps."""
        index = slice(None) if ids is None else ids
        count_steps(num_steps * (self.num if ids is None else len(ids)))
        clipped = np.clip(controls, self.control_low, self.control_high)
        stage = 0 if self.validity.forbidden_contacts == "none" else _POSITION_STAGE
        if not self.space.kinematic:
            self._ctrl[index] = clipped
            with stepping():
                self._batch.step(ids=ids, nstep=num_steps, stage=stage)
            return
        moved = self.space.integrate(self.states()[index], clipped * num_steps * self.model.opt.timestep)
        self.reset(moved, ids)
        if stage:
            with stepping():
                self._batch.forward(ids=ids, stage=stage)

    def states(self) -> Float[np.ndarray, "sim state"]:
        """The states of all simulations."""
        return self._read(len(self._qpos))

    def diverged(self) -> Bool[np.ndarray, " sim"]:
        """Whether each simulation has diverged since its reset: a MuJoCo warning, or a value not finite."""
        warned = self._batch.warning[:, _WARNINGS, 1].any(axis=1)
        parts = (self._qpos, self._qvel, self._act)
        finite = np.logical_and.reduce([np.isfinite(part).all(axis=1) for part in parts])
        return warned | ~finite

    def allowed(self, num: int) -> Bool[np.ndarray, " sim"]:
        """Whether the current state of each of the first `num` simulations is valid."""
        states = self._read(num)
        allowed = self.space.in_bounds(states)
        if self.validity.forbidden_contacts != "none":
            contacts = self._contacts[:num]
            pairs = len(self.validity.pairs)
            allowed &= ~(contacts[:, -pairs:] > 0).any(axis=1) if pairs else contacts == 0
        if self.validity.predicate is not None:
            allowed &= np.asarray(self.validity.predicate(states), dtype=bool)
        return allowed

    def valid_states(self, states: Float[np.ndarray, "sim state"]) -> Bool[np.ndarray, " sim"]:
        """Whether each state is valid; overwrites the states of as many simulations."""
        ids = np.arange(len(states), dtype=np.int32)
        self.reset(states, ids)
        if self.validity.forbidden_contacts != "none":
            with stepping():
                self._batch.forward(ids=ids, stage=_POSITION_STAGE)
        return self.allowed(len(states))

    def dynamics(
        self, ids: Int[np.ndarray, " sim"]
    ) -> tuple[Float[np.ndarray, "sim dof dof"], Float[np.ndarray, "sim dof"]]:
        """Return the inertia matrix and the forces without acceleration, in the current states.

        They are those of inverse dynamics without contacts, constraints and dry friction. Degrees of freedom
        are in the order of the state.
        """
        with stepping():
            self._batch.forward(ids=ids)
        model, dofs = self.model, list(self.space.qvel_index)
        rows = np.repeat(np.arange(model.nv), model.M_rownnz)
        full = np.zeros((len(ids), model.nv, model.nv))
        full[:, rows, model.M_colind] = self._inertia[ids]
        full[:, model.M_colind, rows] = self._inertia[ids]
        forces = self._bias[ids] - self._passive[ids]
        return full[:, dofs][:, :, dofs], forces[:, dofs]

    def mujoco_data(self, sim: int) -> mujoco.MjData:
        """Copy one simulation to an `MjData` with all quantities computed, for rendering."""
        data = self._batch.get_data(sim)
        with stepping():
            mujoco.mj_forward(self.model, data)
        return data

    def propagate(
        self,
        starts: Float[np.ndarray, "edge state"],
        controls: Float[np.ndarray, "edge control"],
        durations: Int[np.ndarray, " edge"],
        stride: int = 1,
    ) -> tuple[Float[np.ndarray, "edge state"], Bool[np.ndarray, " edge"]]:
        """Simulate one edge of a planning tree in each simulation.

        Args:
            starts: start state of each edge; at most `num` edges.
            controls: control of each edge, constant along it.
            durations: number of physics steps of each edge, a multiple of `stride`.
            stride: number of physics steps between two checks of the states.

        Returns:
            The end state of each edge, and whether the edge is valid: its state is valid at every check, and
            MuJoCo gave no warning of any kind.
        """
        order = np.argsort(-durations, kind="stable")  # longest first: the edges still moving are a prefix
        sorted_durations = durations[order]
        n = len(starts)
        every = np.arange(n, dtype=np.int32)
        self.reset(starts[order], every)
        valid = np.ones(n, dtype=bool)
        for step in range(0, int(sorted_durations[0]), stride):
            moving = every[: np.searchsorted(-sorted_durations, -step, side="left")]
            self.step(controls[order[: len(moving)]], stride, ids=moving)
            valid[: len(moving)] &= self.allowed(len(moving))
        ends = self._read(n)
        valid &= ~self._batch.warning[:n, :, 1].any(axis=1)  # any kind, not only divergence
        inverse = np.argsort(order, kind="stable")
        return ends[inverse], valid[inverse]

    def _read(self, num: int) -> Float[np.ndarray, "sim state"]:
        """The states of the first `num` simulations."""
        return self.space.read(self._qpos[:num], self._qvel[:num], self._act[:num], self._history[:num])


def control_bounds(model: mujoco.MjModel, space: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper bound of each control; infinite where the model has no limit."""
    if space.kinematic:
        return -space.velocity_bound, space.velocity_bound.copy()
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)
    return low, high
