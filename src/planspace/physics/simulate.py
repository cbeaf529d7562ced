"""Many copies of one model stepped together on a thread pool, and the plain loop that checks them.

The physics is MuJoCo's own C code through `mujoco.batch`: bit-identical to a loop over `mj_step` at any
number of threads. MuJoCo would silently reset a state that diverged; our models switch that off
(`autoreset`), and `Simulator.diverged` reads the warning counters.

A kinematic space has no dynamics: there a control is the velocity of each degree of freedom, a step moves
the positions along it, and only contacts are computed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.compile import GeomPairs, stepping
from planspace.physics.space import StateSpace

_WARNINGS = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),  # MuJoCo then takes all controls as 0
]


_POSITION_STAGE = int(mujoco.mjtStage.mjSTAGE_POS)

MAX_REPEATS = 100_000
"""Steps between two recorded states."""


@dataclass(frozen=True)
class Validity:
    """What a state must not do beside leaving its bounds."""

    forbidden_contacts: Literal["none", "all"] | GeomPairs = "none"
    """No contact is forbidden, every one is, or those between the geoms of each pair."""
    predicate: Callable[[np.ndarray], np.ndarray] | None = None
    """States [batch, state] to whether each is allowed [batch]; to be used in workers it must be a function
    that a module has by name."""

    @property
    def pairs(self) -> GeomPairs:
        """The pairs of geoms that must not touch; empty where all or none are meant."""
        return () if isinstance(self.forbidden_contacts, str) else self.forbidden_contacts


FREE = Validity()
"""Nothing is forbidden."""


class Simulator:
    """`num` simulations of one model."""

    def __init__(
        self,
        model: mujoco.MjModel,
        space: StateSpace,
        num: int,
        *,
        threads: int = 0,
        validity: Validity = FREE,
    ):
        """Starts the simulations.

        Args:
            model: the compiled model; it watches the pairs of `validity`, if there are any.
            space: which joints make the state.
            num: how many simulations.
            threads: physics threads; 0 takes all CPUs. Results do not depend on it.
            validity: what makes an edge invalid beside leaving the bounds.

        Raises:
            UsageError: the model's actuators have a state of their own (muscles, filters).
        """
        if model.na and not space.kinematic:
            raise UsageError("the model's actuators have activations, a state that is not planned for.")
        self.model, self.space, self.num, self.validity = model, space, num, validity
        self.threads = threads
        with stepping():
            self._batch = Batch(model, num, threads)
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        self._warmstart = self._batch.bind("qacc_warmstart")
        if validity.forbidden_contacts != "none":
            self._contacts = self._batch.bind("sensordata" if validity.pairs else "ncon")
        self.control_low, self.control_high = control_bounds(model, space)

    def reset(self, states: Float[np.ndarray, "sim state"], ids: np.ndarray | None = None) -> None:
        """Puts simulations (all, or those of `ids`) into the given states, with a cold solver."""
        index = slice(None) if ids is None else ids
        qpos, qvel = self._qpos[index], self._qvel[index]
        self.space.write(states, qpos, qvel)
        self._qpos[index], self._qvel[index] = qpos, qvel
        self._warmstart[index] = 0.0
        self._batch.warning[index] = 0

    def step(
        self, controls: Float[np.ndarray, "sim control"], num_steps: int = 1, ids: np.ndarray | None = None
    ) -> None:
        """Holds each control, clipped to its bounds, for a number of physics steps."""
        index = slice(None) if ids is None else ids
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
        return self.space.read(self._qpos, self._qvel)

    def diverged(self) -> Bool[np.ndarray, " sim"]:
        """Which simulations MuJoCo has warned of, or hold a number that is not finite, since their reset."""
        warned = self._batch.warning[:, _WARNINGS, 1].any(axis=1)
        finite = np.isfinite(self._qpos).all(axis=1) & np.isfinite(self._qvel).all(axis=1)
        return warned | ~finite

    def allowed(self, num: int) -> Bool[np.ndarray, " sim"]:
        """Whether each of the first `num` simulations is within bounds now, and does nothing forbidden."""
        states = self.space.read(self._qpos[:num], self._qvel[:num])
        allowed = self.space.in_bounds(states)
        if self.validity.forbidden_contacts != "none":
            contacts = self._contacts[:num]
            pairs = len(self.validity.pairs)
            allowed &= ~(contacts[:, -pairs:] > 0).any(axis=1) if pairs else contacts == 0
        if self.validity.predicate is not None:
            allowed &= np.asarray(self.validity.predicate(states), dtype=bool)
        return allowed

    def valid_states(self, states: Float[np.ndarray, "sim state"]) -> Bool[np.ndarray, " sim"]:
        """Whether each state is within bounds and does nothing forbidden; overwrites simulations."""
        ids = np.arange(len(states), dtype=np.int32)
        self.reset(states, ids)
        if self.validity.forbidden_contacts != "none":
            with stepping():
                self._batch.forward(ids=ids, stage=_POSITION_STAGE)
        return self.allowed(len(states))

    def mujoco_data(self, sim: int) -> mujoco.MjData:
        """One simulation as an `MjData` with everything computed, for rendering."""
        data = self._batch.get_data(sim)
        with stepping():
            mujoco.mj_forward(self.model, data)
        return data

    def propagate(
        self,
        starts: Float[np.ndarray, "edge state"],
        controls: Float[np.ndarray, "edge control"],
        durations: Int[np.ndarray, " edge"],
    ) -> tuple[Float[np.ndarray, "edge state"], Bool[np.ndarray, " edge"]]:
        """Simulates one edge of a planning tree in each simulation.

        Args:
            starts: where each edge begins; at most `num` edges.
            controls: the control held along each edge.
            durations: how many physics steps each edge lasts, at least 1.

        Returns:
            Where each edge ends, and whether it is valid: within bounds and nothing forbidden after every
            step, and no warning of any kind.
        """
        order = np.argsort(-durations, kind="stable")  # the longest first: those still moving are a prefix
        sorted_durations = durations[order]
        n = len(starts)
        everyone = np.arange(n, dtype=np.int32)
        self.reset(starts[order], everyone)
        valid = np.ones(n, dtype=bool)
        for step in range(int(sorted_durations[0])):
            moving = everyone[: np.searchsorted(-sorted_durations, -step, side="left")]
            self.step(controls[order[: len(moving)]], ids=moving)
            valid[: len(moving)] &= self.allowed(len(moving))
        ends = self.space.read(self._qpos[:n], self._qvel[:n])
        valid &= ~self._batch.warning[:n, :, 1].any(axis=1)  # of any kind, not of divergence alone
        inverse = np.argsort(order, kind="stable")
        return ends[inverse], valid[inverse]


def control_bounds(model: mujoco.MjModel, space: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bound of each control; infinite where the model sets none."""
    if space.kinematic:
        return -space.velocity_bound, space.velocity_bound.copy()
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)
    return low, high


def advance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    space: StateSpace,
    control: Float[np.ndarray, " control"],
    num_steps: int = 1,
) -> Float[np.ndarray, " state"]:
    """Holds a control for some steps of plain MuJoCo; returns the state after them."""
    if space.kinematic:
        before = space.read(data.qpos, data.qvel)
        space.write(space.integrate(before, control * num_steps * model.opt.timestep), data.qpos, data.qvel)
    else:
        data.ctrl[:] = control
        with stepping():
            mujoco.mj_step(model, data, nstep=num_steps)
    return space.read(data.qpos, data.qvel)


def replay(
    model: mujoco.MjModel,
    space: StateSpace,
    start: Float[np.ndarray, " state"],
    controls: Float[np.ndarray, "step control"],
    times: Float[np.ndarray, " time"],
) -> Float[np.ndarray, "time state"]:
    """Rolls recorded controls out in plain MuJoCo.

    Args:
        model: the compiled model; its time step is left as it was.
        space: which joints make the state.
        start: the first state.
        controls: the control held between one time and the next.
        times: when each state was recorded [s]; an interval that is no multiple of the model's time step is
            simulated as one step of its own length.

    Returns:
        The state at each time.

    Raises:
        PlanspaceError: an interval is more steps than anyone would have left out, or MuJoCo cannot go on.
    """
    data = mujoco.MjData(model)
    space.write(start, data.qpos, data.qvel)
    states = [np.array(start, dtype=float)]
    own_step = model.opt.timestep
    try:
        for control, interval in zip(controls, np.diff(times), strict=True):
            if not interval <= MAX_REPEATS * own_step:
                raise PlanspaceError(
                    f"two states lie {interval:.3g} s apart, more than {MAX_REPEATS} steps of the model."
                )
            repeats = round(interval / own_step)
            whole = repeats >= 1 and abs(interval - repeats * own_step) < 1e-3 * own_step
            model.opt.timestep = own_step if whole else interval
            states.append(advance(model, data, space, control, repeats if whole else 1))
    finally:
        model.opt.timestep = own_step
    return np.stack(states)
