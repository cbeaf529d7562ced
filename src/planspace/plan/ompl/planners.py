"""The planners of OMPL: their names and settings. `process` runs one; nothing else imports OMPL."""

import importlib.metadata
import importlib.util
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from tyro.conf import Suppress

from planspace.errors import PlanspaceError, UsageError, check_setting, install_command, unknown
from planspace.plan.planner import Failure, Plan

if TYPE_CHECKING:
    from planspace.plan.query import Query
    from planspace.tasks.problem import Problem

CONTROL_ALGORITHMS = ("SST", "RRT", "EST", "KPIECE1", "PDST")
"""OMPL's planners for problems with dynamics."""
GEOMETRIC_ALGORITHMS = ("RRTConnect", "RRTstar", "PRM", "BITstar")
"""OMPL's planners for kinematic problems."""
VERSION = "1.7.0"
"""The last version whose Python bindings can construct every planner named here."""
NOT_IN_VERSION_2 = ("SST", "PDST")


@dataclass(frozen=True)
class OMPL:
    """A planner of OMPL. Every plan runs in a separate process, because OMPL's bindings can crash."""

    searches_elsewhere: ClassVar[bool] = True
    algorithm: Annotated[str, Suppress] = "RRT"
    """OMPL's name for the planner."""
    seconds: float = 20.0
    """Time for each search [s]. Planners that improve their plans use all of it."""
    iterations: int = 0
    """If positive, stop after this many iterations instead, which is reproducible if the planner is."""
    goal_bias: float = 0.1
    """Fraction of samples at the goal, for planners that have this setting."""
    selection_radius: float = 0.3
    """SST's selection radius, in the weighted distance of neighbour search (2020: 0.002, unit weights)."""
    pruning_radius: float = 0.08
    """SST's pruning radius (2020: 0.0005)."""
    min_edge_s: float = 0.02
    """Shortest time for which an edge holds its control [s]; at least one physics step."""
    max_edge_s: float = 0.2
    """Longest time for which an edge holds its control [s]."""

    @property
    def name(self) -> str:
        """The name in `PLANNERS`."""
        return f"ompl-{self.algorithm.lower()}"

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: a setting is out of its range.
        """
        algorithms = (*CONTROL_ALGORITHMS, *GEOMETRIC_ALGORITHMS)
        if self.algorithm not in algorithms:
            raise unknown("ompl_algorithm", self.algorithm, algorithms)
        check_setting("ompl_seconds", self.seconds, self.seconds > 0, "above 0")
        check_setting("ompl_iterations", self.iterations, self.iterations >= 0, "at least 0")
        check_setting("ompl_goal_bias", self.goal_bias, 0 <= self.goal_bias <= 1, "between 0 and 1")
        least, most = self.min_edge_s, self.max_edge_s
        wanted = f"above 0 and at most ompl_max_edge_s, {most}"
        check_setting("ompl_min_edge_s", least, 0 < least <= most, wanted)

    def plan(self, query: "Query", rng: np.random.Generator) -> Plan | Failure:
        """Search once, in a process that may crash."""
        from planspace.plan.ompl.process import plan_in_process

        return plan_in_process(self, query, seed=int(rng.integers(1, 1 << 31)))

    def check(self, problem: "Problem") -> None:
        """Check that this planner can be used on a problem.

        Raises:
            UsageError: the planner is for the other kind of problem.
            PlanspaceError: OMPL is not installed, or its version cannot construct this planner.
        """
        usable = GEOMETRIC_ALGORITHMS if problem.kinematic else CONTROL_ALGORITHMS
        if self.algorithm not in usable:
            kind = "kinematic" if problem.kinematic else "dynamic"
            names = ["sst", *(OMPL(name).name for name in usable)]
            raise UsageError(f"{self.name} cannot plan a {kind} problem; {', '.join(names)} can.")
        if importlib.util.find_spec("ompl") is None:
            raise PlanspaceError(f"OMPL is not installed: {install_command('ompl')}.")
        version = importlib.metadata.version("ompl")
        if not version.startswith("1.") and self.algorithm in NOT_IN_VERSION_2:
            raise PlanspaceError(
                f"the Python bindings of OMPL {version} cannot construct {' and '.join(NOT_IN_VERSION_2)}, "
                f"only RRT, EST and KPIECE1. Version {VERSION} can: pip install 'ompl=={VERSION}'."
            )


OMPL_PLANNERS = {planner.name: planner for planner in map(OMPL, (*CONTROL_ALGORITHMS, *GEOMETRIC_ALGORITHMS))}
"""Name to planner with default settings."""
