"""Many copies of one model stepped together on a thread pool, and the plain loop that checks them.

The physics is MuJoCo's own C code through `mujoco.batch`: bit-identical to a loop over `mj_step` at any
number of threads. MuJoCo would silently reset a state that diverged; our models switch that off
(`autoreset`), and `Simulator.diverged` reads the warning counters.
"""

from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from planspace.errors import PlanspaceError
from planspace.physics.space import StateSpace

ASSETS = Path(__file__).parent.parent / "assets"

_WARNINGS = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


def load_model(xml: str) -> mujoco.MjModel:
    """Compiles an MJCF text, with MuJoCo's silent reset of diverged states switched off.

    Raises:
        PlanspaceError: MuJoCo does not accept it; the message is MuJoCo's.
    """
    try:
        model = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise PlanspaceError(f"the model does not compile: {error}") from error
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model


class Simulator:
    """`num` simulations of one model."""

    def __init__(self, model: mujoco.MjModel, space: StateSpace, num: int, *, threads: int = 0):
        """Starts the simulations.

        Args:
            model: the compiled model.
            space: which joints make the state.
            num: how many simulations.
            threads: physics threads; 0 takes all CPUs. Results do not depend on it.
        """
        self.model, self.space, self.num = model, space, num
        self._batch = Batch(model, num, threads)
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        self._warmstart = self._batch.bind("qacc_warmstart")
        self.control_low, self.control_high = control_bounds(model)

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
        """Holds each control, clipped to the actuators' range, for a number of physics steps."""
        clipped = np.clip(controls, self.control_low, self.control_high)
        self._ctrl[slice(None) if ids is None else ids] = clipped
        self._batch.step(ids=ids, nstep=num_steps)

    def states(self) -> Float[np.ndarray, "sim state"]:
        """The states of all simulations."""
        return self.space.read(self._qpos, self._qvel)

    def diverged(self) -> Bool[np.ndarray, " sim"]:
        """Which simulations MuJoCo has warned of, or hold a number that is not finite, since their reset."""
        warned = self._batch.warning[:, _WARNINGS, 1].any(axis=1)
        finite = np.isfinite(self._qpos).all(axis=1) & np.isfinite(self._qvel).all(axis=1)
        return warned | ~finite

    def mujoco_data(self, sim: int) -> mujoco.MjData:
        """One simulation as an `MjData` with everything computed, for rendering."""
        data = self._batch.get_data(sim)
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
            Where each edge ends, and whether it is valid: within bounds after every step, and no warning.
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
            now = self.space.read(self._qpos[: len(moving)], self._qvel[: len(moving)])
            valid[: len(moving)] &= self.space.in_bounds(now)
        ends = self.space.read(self._qpos[:n], self._qvel[:n])
        valid &= ~self.diverged()[:n]
        inverse = np.argsort(order, kind="stable")
        return ends[inverse], valid[inverse]


def control_bounds(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bound of each control; infinite where the model sets none."""
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)
    return low, high


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
    """
    data = mujoco.MjData(model)
    space.write(start, data.qpos, data.qvel)
    states = [np.array(start, dtype=float)]
    own_step = model.opt.timestep
    try:
        for control, interval in zip(controls, np.diff(times), strict=True):
            repeats = round(interval / own_step)
            whole = repeats >= 1 and abs(interval - repeats * own_step) < 1e-3 * own_step
            model.opt.timestep = own_step if whole else interval
            data.ctrl[:] = control
            mujoco.mj_step(model, data, nstep=repeats if whole else 1)
            states.append(space.read(data.qpos, data.qvel))
    finally:
        model.opt.timestep = own_step
    return np.stack(states)
