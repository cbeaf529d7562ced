"""The planner `sst`: its settings. The search itself is in `sst_search`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from planspace.errors import check_setting
from planspace.plan.planner import Failure, Plan

if TYPE_CHECKING:
    from planspace.plan.query import Query


COUNTS = (
    "extensions",
    "min_rounds",
    "max_rounds",
    "shrink_every",
    "tail_every",
    "tail_candidates",
)
"""Settings that must be at least 1."""


@dataclass(frozen=True)
class SST:
    """Stable sparse trees (SST*), with many extensions per round.

    Budgets count rounds, so that a seed gives the same plan on every machine.
    """

    name: ClassVar[str] = "sst"
    default_restarts: ClassVar[int] = 2

    extensions: int = 512
    """Extensions per round."""
    min_rounds: int = 4
    """Rounds before a solution is accepted, so that the first solution can be improved."""
    max_rounds: int = 240
    """Rounds before giving up."""
    seconds: float = 0.0
    """If positive, search and improve for this many seconds instead of counting rounds; not reproducible."""
    min_edge_s: float = 0.02
    """Shortest time for which an edge holds its control [s]; at least one physics step."""
    max_edge_s: float = 0.2
    """Longest time for which an edge holds its control [s]."""
    goal_bias: float = 0.1
    """Fraction of extensions that aim at the goal."""
    bang_bang: float = 0.3
    """Fraction of controls drawn at the ends of their range instead of inside it."""
    hold_last: float = 0.0
    """Fraction of edges that go on with the action of the edge before them."""
    servo: float = 0.0
    """Fraction of the other edges that drive the motors' joints to a random pose, instead of applying one
    control."""
    greedy: float = 0.0
    """Fraction of extensions that start from nodes near the goal instead of nodes near a random state. Near
    is measured as the goal measures it, or by --metric; with a metric, 0 means 0.25."""
    selection_radius: float = 0.3
    """Best-near selection chooses the cheapest node within this feature distance."""
    witness_size: float = 0.08
    """Side of a witness cell, in features."""
    shrink: float = 0.8
    """Factor by which selection radius and witness cells shrink."""
    shrink_every: int = 60
    """Number of rounds between two shrinks."""
    tail_every: int = 4
    """Number of rounds between two attempts of the regulator to reach the goal."""
    tail_candidates: int = 32
    """Number of new nodes, the most promising ones, from which the regulator tries."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: a setting is out of its range.
        """
        for name in COUNTS:
            check_setting(name, getattr(self, name), getattr(self, name) >= 1, "at least 1")
        least, most = self.min_edge_s, self.max_edge_s
        check_setting("min_edge_s", least, 0 < least <= most, f"above 0 and at most max_edge_s, {most}")
        for name in ("seconds", "selection_radius"):
            check_setting(name, getattr(self, name), getattr(self, name) >= 0, "at least 0")
        for name in ("goal_bias", "bang_bang", "hold_last", "servo", "greedy"):
            check_setting(name, getattr(self, name), 0 <= getattr(self, name) <= 1, "between 0 and 1")
        check_setting("shrink", self.shrink, 0 < self.shrink <= 1, "above 0 and at most 1")
        check_setting("witness_size", self.witness_size, self.witness_size > 0, "above 0")

    def plan(self, query: "Query", rng: np.random.Generator) -> Plan | Failure:
        """Grow a tree from the start until the regulator reaches the goal from one of its nodes."""
        from planspace.plan.sst_search import SSTSearch

        found = SSTSearch(self, query, rng).solve()
        if found.arrived:
            return Plan(found.controls, found.tree)
        reason = f"no path found within the budget: {found.explanation}"
        return Failure(reason, found.nearest, found.controls, found.tree)
