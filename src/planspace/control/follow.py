"""Following a plan to the goal, where a simulation shows that a regulator can."""

import numpy as np
from jaxtyping import Float, Int

from planspace.control.plant import Plant
from planspace.control.takeover import Takeover
from planspace.demos.dataset import Demos
from planspace.errors import UsageError
from planspace.plan.tracking import TrackedPlans

NEAREST = 256
"""States of plans that are tried at once."""
CHECK_S = 0.1
"""Time between two trials [s]."""
DRIFT, SLACK = 2.0, 1.0
"""A trial is given up when its cost to go in the linear model exceeds `DRIFT` times the first + `SLACK`."""


class PlanFollower:
    """Plans, each with a linear regulator along it, and the simulation that decides which is followed.

    It tries the states of plans to which the regulators return at the least cost, as the linear model
    estimates it. From the present state, it simulates these regulators, and follows the first that reaches
    the goal and stays there.
    """

    def __init__(self, plant: Plant, plans: Demos, within_s: float, threads: int = 1):
        """Linearise along the plans.

        Args:
            plant: what is controlled.
            plans: plans of the same robot, with controls.
            within_s: how far from the end of its plan a state may be [s].
            threads: physics threads; 0 uses all CPUs.

        Raises:
            UsageError: the plans are of another robot, or too short.
        """
        self._plant, self._simulator = plant, plant.simulator(NEAREST, threads)
        self._within = round(within_s / plant.control_step)
        self._tracks = TrackedPlans.of(
            plans_of(plant, plans), self._simulator, plant.physics_steps, self._within
        )
        self._rows = np.arange(len(self._tracks.remaining))
        self._every = max(1, round(CHECK_S / plant.control_step))

    def start(self, takeover: Takeover) -> None:
        """Begin an episode, whose goal and regulator there are the takeover's."""
        self._takeover = takeover
        self.leave()

    def leave(self) -> None:
        """Leave the plan that is followed, if there is one; the next control begins with a trial."""
        self._row, self._age = -1, self._every

    def control(self, state: Float[np.ndarray, " state"]) -> Float[np.ndarray, " control"] | None:
        """The control of the plan that is followed; None if there is none."""
        if self._row >= 0:
            self._row = self._row + 1 if self._tracks.remaining[self._row] > 1 else -1
        self._age += 1
        if self._age >= self._every:
            self._age = 0
            if self._row >= 0:
                self._row = self._first_to_arrive(state, np.array([self._row]))
            if self._row < 0:
                self._row = self._first_to_arrive(state, self._nearest(state))
        if self._row < 0:
            return None
        row = np.array([self._row])
        return self._tracks.control(row, self._tracks.off(row, state[None]))[0]

    def _nearest(self, state: Float[np.ndarray, " state"]) -> Int[np.ndarray, " row"]:
        """The steps of plans to which the regulator returns at the least cost."""
        costs = self._tracks.cost_to_go(self._rows, self._tracks.off(self._rows, state[None]))
        num = min(NEAREST, len(costs))
        return np.argpartition(costs, num - 1)[:num]

    def _first_to_arrive(self, state: Float[np.ndarray, " state"], rows: Int[np.ndarray, " row"]) -> int:
        """The row from which the regulator along its plan holds the goal first; -1 if none does."""
        simulator, tracks, takeover = self._simulator, self._tracks, self._takeover
        ids = np.arange(len(rows), dtype=np.int32)
        simulator.reset(np.repeat(state[None], len(rows), axis=0), ids)
        at, left, held = rows.copy(), tracks.remaining[rows], np.zeros(len(rows), dtype=int)
        limit = DRIFT * tracks.cost_to_go(at, tracks.off(at, state[None])) + SLACK
        for _ in range(self._within + takeover.arrive + takeover.hold):
            before = simulator.states()[ids]
            off, on_plan = tracks.off(at, before), left > 0
            lost = on_plan & (tracks.cost_to_go(at, off) > limit)
            controls = np.where(on_plan[:, None], tracks.control(at, off), takeover.regulator.control(before))
            simulator.step(controls, self._plant.physics_steps, ids)
            at, left = np.where(left > 1, at + 1, at), left - 1
            held = np.where(takeover.goal.reached(simulator.states()[ids]), held + 1, 0)
            valid = simulator.allowed(NEAREST)[ids] & ~simulator.diverged()[ids]
            arrived = valid & (held >= takeover.hold)
            if arrived.any():
                return int(rows[ids[np.argmax(arrived)]])
            kept = valid & ~lost & ~((left < -takeover.arrive) & (held == 0))
            if not kept.any():
                break
            ids, at, left, held, limit = ids[kept], at[kept], left[kept], held[kept], limit[kept]
        return -1


def plans_of(plant: Plant, plans: Demos) -> Demos:
    """The plans with the states of the plant.

    Raises:
        UsageError: they have other states, or other controls or none.
    """
    names, num = plant.space.names, plant.model.nu
    if missing := [name for name in names if name not in plans.info.names]:
        raise UsageError(
            f"the plans to follow have no {', '.join(missing)}: give plans of {plant.problem.name}."
        )
    if plans.info.num_controls != num or not plans.controls.any():
        raise UsageError(
            f"the plans to follow need {num} controls a step that are not all 0, and these have "
            f"{plans.info.num_controls}: give plans that `planspace plan` made for {plant.problem.name}."
        )
    return plans.select(names)
