"""One plan after another: search, polish, and proof in plain MuJoCo."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from planspace.demos.dataset import Episode
from planspace.errors import UsageError, unknown
from planspace.physics.angles import unwrap_to_end
from planspace.physics.replay import advance
from planspace.physics.simulator import Simulator
from planspace.physics.space import StateSpace
from planspace.plan.clearance import Clearance
from planspace.plan.ompl import OMPL_PLANNERS, OMPLConfig, plan_in_process
from planspace.plan.polish import Polish, PolishConfig, Trajectory
from planspace.plan.regulator import Regulator, RegulatorConfig
from planspace.plan.sst import SST, Search, SSTConfig
from planspace.tasks.problem import Goal, Problem

MAX_ATTEMPTS = 3
"""A plan that fails is tried again from another start, this many times in all."""
MAX_REDRAWS = 1000
"""A start that lies in the goal region is drawn again at most so many times."""
MIN_SIMULATIONS = 64
"""The planner's simulations are at least so many, however few extensions it makes a round."""
LANDINGS = (1.0, 0.5, 0.2)
"""A polished plan whose goal cannot be held is polished again towards these shares of the tolerance ..."""
DEEPER_STEPS = 10
"""... with so many physics steps more."""
PARTS = {"sst": SSTConfig, "regulator": RegulatorConfig, "polish": PolishConfig, "ompl": OMPLConfig}
"""The parts of a planner's configuration, by the prefix of their settings."""
LARGEST_SETTING = 1e12
PLANNERS = ("sst", *OMPL_PLANNERS)
"""Every planner's name."""


@dataclass(frozen=True)
class PlannerConfig:
    """How demonstrations are planned."""

    planner: str = "sst"
    """`sst` is ours; `ompl-NAME` one of OMPL's."""
    restarts: int = 2
    """Independent searches for each plan, of which the best is kept (one for OMPL's planners)."""
    sst: SSTConfig = field(default_factory=SSTConfig)
    """The sampling planner."""
    regulator: RegulatorConfig = field(default_factory=RegulatorConfig)
    """The regulator that takes over near the goal and holds it."""
    polish: PolishConfig = field(default_factory=PolishConfig)
    """What makes a plan short."""
    ompl: OMPLConfig = field(default_factory=OMPLConfig)
    """OMPL's planners."""

    def __post_init__(self) -> None:
        """Checks the planner's name and the restarts."""
        if self.planner not in PLANNERS:
            raise unknown("planner", str(self.planner), PLANNERS)
        if self.restarts < 1:
            raise ValueError(f"restarts must be at least 1, got {self.restarts}")

    @classmethod
    def for_problem(cls, problem: Problem, /, **changes: Any) -> "PlannerConfig":
        """The defaults with the problem's own settings, and further changes.

        Args:
            problem: its `settings` name fields of the parts, those of OMPL as `ompl_NAME`.
            changes: fields of this class, or of a part as `part_field`; None leaves the default.

        Raises:
            UsageError: a setting that no part has.
        """
        given = {"planner": problem.planner, **dict(problem.settings)}
        given |= {key: value for key, value in changes.items() if value is not None}
        defaults = cls()
        changed: dict[str, dict[str, Any]] = {"": {}, **{name: {} for name in PARTS}}
        for key, value in given.items():
            part, name = _place(key)
            default = getattr(getattr(defaults, part) if part else defaults, name)
            changed[part][name] = value if key == "planner" else _like(default, key, value)
        try:
            parts = {name: replace(getattr(defaults, name), **changed[name]) for name in PARTS}
            return replace(defaults, **changed[""], **parts)
        except ValueError as error:
            raise UsageError(f"settings: {error}.") from error


def _place(key: str) -> tuple[str, str]:
    """The part and the field a setting names; those of SST need no prefix."""
    known = {"restarts": ("", "restarts"), "planner": ("", "planner")}
    for part, kind in PARTS.items():
        known |= {f"{part}_{f.name}": (part, f.name) for f in fields(kind)}
    if key not in known and f"sst_{key}" not in known:
        raise unknown("setting", key, known)
    return known.get(key) or known[f"sst_{key}"]


def _like(default: int | float, key: str, value: Any) -> int | float:
    """A number from a file or the command line, whole where the default is."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST_SETTING:
        raise UsageError(f"setting {key!r} takes a number, got {value!r}.")
    if isinstance(default, int) and value != int(value):
        raise UsageError(f"setting {key!r} takes a whole number, got {value!r}.")
    return type(default)(value)


@dataclass(frozen=True)
class Failure:
    """A plan that was not found."""

    nearest: float
    """How near the goal any search came, in the goal's measure."""
    reason: str
    """What stood in the way at the last attempt."""


class Planner:
    """Plans of one problem, one after another, in one process."""

    def __init__(self, problem: Problem, config: PlannerConfig, *, threads: int = 1):
        """Compiles the problem.

        Args:
            problem: what to plan.
            config: planner settings.
            threads: physics threads.
        """
        self.problem, self.config = problem, config
        self.model, self.space = problem.compile()
        self.simulator = Simulator(
            self.model,
            self.space,
            max(config.sst.extensions, config.sst.tail_candidates, MIN_SIMULATIONS),
            threads=threads,
            validity=problem.validity,
        )
        self.weights = problem.weights(self.space)
        watched = problem.forbidden_contacts != "none"
        self.clearance = Clearance(problem, self.space, threads=threads) if watched else None

    def plan(self, seed: int, index: int) -> Episode | Failure:
        """Plans one demonstration, from another start after a failure, and verifies it in plain MuJoCo."""
        nearest, reason = np.inf, ""
        for attempt in range(MAX_ATTEMPTS):
            rng = np.random.default_rng(np.random.SeedSequence([seed, index, attempt]))
            start = self.problem.draw_start(self.simulator, rng)
            goal = self.problem.draw_goal(self.space, rng, self.simulator)
            for _ in range(MAX_REDRAWS):  # a start inside the goal region is no demonstration
                if not goal.reached(start):
                    break
                start = self.problem.draw_start(self.simulator, rng)
            found = self.connect(start, goal, rng)
            if not isinstance(found, Failure):
                times = np.arange(len(found.states)) * self.model.opt.timestep
                states = _continuous(self.space, found.states)
                cost = float(self.problem.step_cost(self.simulator, found.controls).sum())
                return Episode(
                    states, found.controls, times, goal.center, True, index=index, seed=attempt, cost=cost
                )
            nearest, reason = min(nearest, found.nearest), found.reason
        return Failure(nearest, reason)

    def connect(
        self, start: Float[np.ndarray, " state"], goal: Goal, rng: np.random.Generator
    ) -> Trajectory | Failure:
        """The cheapest verified plan of some searches from one start."""
        if goal.reached(start):
            return Failure(0.0, "the start lies in the goal region")
        regulator = Regulator(self.simulator, goal, self.weights, self.config.regulator)
        best, nearest, reason = None, np.inf, ""
        for _ in range(self.config.restarts if self.config.planner == "sst" else 1):
            search = self._search(start, goal, regulator, rng)
            nearest = min(nearest, search.nearest)
            for controls in self._finished(search, regulator, start):
                plan = self.record(regulator, start, controls)
                if isinstance(plan, Trajectory):
                    if best is None or self._cost(plan) < self._cost(best):
                        best = plan
                    break
                reason = plan
            else:
                reason = reason or search.note or "no path found within the budget"
        return best if best is not None else Failure(nearest, reason)

    def _search(
        self, start: np.ndarray, goal: Goal, regulator: Regulator, rng: np.random.Generator
    ) -> Search:
        if self.config.planner == "sst":
            return SST(self.problem, self.simulator, regulator, self.config.sst, rng).solve(start)
        seed = int(rng.integers(1, 1 << 31))
        return plan_in_process(self.problem, self.config.planner, self.config.ompl, start, goal, seed)

    def _finished(self, search: Search, regulator: Regulator, start: np.ndarray) -> Iterator[np.ndarray]:
        """Ways to end a search's path, the shortest first; each is tried only if those before fail.

        Where the goal is entered too fast to be held, the next lands deeper in it, with some steps more.
        """
        goal = regulator.goal
        if len(search.controls) == 0:
            return
        effort = self.problem.cost == "effort"
        guess = search.controls
        for landing in LANDINGS if self.config.polish.max_iterations else ():
            config = replace(self.config.polish, landing=landing * self.config.polish.landing)
            polish = Polish(
                self.simulator, goal, self.weights, config, clearance=self.clearance, effort=effort
            )
            controls = polish.run(start, guess)
            if controls is None:
                break
            yield controls
            guess = np.concatenate([controls, self._more(regulator, start, controls)])
        if search.arrived:
            yield search.controls

    def _more(self, regulator: Regulator, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """What the regulator does in the steps after a plan."""
        data = mujoco.MjData(self.model)
        self.space.write(start, data.qpos, data.qvel)
        state = start
        for control in controls:
            state = advance(self.model, data, self.space, control)
        more = []
        for _ in range(DEEPER_STEPS):
            more.append(regulator.control(state))
            state = advance(self.model, data, self.space, more[-1])
        return np.stack(more)

    def record(
        self, regulator: Regulator, start: Float[np.ndarray, " state"], controls: np.ndarray
    ) -> Trajectory | str:
        """Runs controls in plain MuJoCo from a start until they first enter the goal region.

        Afterwards what is left of the controls and then the regulator hold the goal, where the problem wants
        it, which is checked and not recorded.

        Returns:
            One state and one control for each physics step; or what was wrong: the run leaves the bounds or
            does what is forbidden, never arrives, or cannot hold the goal.
        """
        model, space, data = self.model, self.space, mujoco.MjData(self.model)
        space.write(start, data.qpos, data.qvel)
        states = [np.array(start)]
        for control in controls:
            if regulator.goal.reached(states[-1]):
                break
            states.append(advance(model, data, space, control))
        if not regulator.goal.reached(states[-1]):
            return "the path does not arrive when replayed"
        if any(w.number for w in data.warning) or not self._all_valid(np.stack(states)):
            return "the path leaves what is valid when replayed"
        if self.problem.hold and not self._holds(regulator, data, states[-1], controls[len(states) - 1 :]):
            return "the goal cannot be held (hold: false plans without)"
        return Trajectory(np.stack(states), controls[: len(states) - 1])

    def _holds(self, regulator: Regulator, data: mujoco.MjData, state: np.ndarray, rest: np.ndarray) -> bool:
        """Whether the rest of the controls and then the regulator stay valid and end in the goal region."""
        held = [state]
        for control in rest:
            held.append(advance(self.model, data, self.space, control))
        for _ in range(regulator.config.hold_steps):
            held.append(advance(self.model, data, self.space, regulator.control(held[-1])))
        valid = not any(w.number for w in data.warning) and self._all_valid(np.stack(held))
        return valid and bool(regulator.goal.reached(held[-1]))

    def _all_valid(self, states: np.ndarray) -> bool:
        size = self.simulator.num
        parts = [states[i : i + size] for i in range(0, len(states), size)]
        return all(self.simulator.valid_states(part).all() for part in parts)

    def _cost(self, plan: Trajectory) -> float:
        return float(self.problem.step_cost(self.simulator, plan.controls).sum())


def _continuous(space: StateSpace, states: np.ndarray) -> np.ndarray:
    """Angles end in (-pi, pi] and quaternions with w >= 0; neither jumps on the way."""
    states = states.copy()
    for column in space.circular_columns:
        states[:, column] = unwrap_to_end(states[:, column])
    for column in space.quaternion_columns:
        if states[-1, column] < 0:
            states[:, column : column + 4] *= -1.0
    return states
