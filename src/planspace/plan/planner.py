"""The seam for planners: what a planner returns, and the checks of planners and of what they return."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from planspace.demos.search_tree import SearchTree, as_tree
from planspace.errors import UsageError, quoted
from planspace.seams import check_fits, name_of

if TYPE_CHECKING:
    from planspace.plan.query import Query
    from planspace.tasks.problem import Problem

PAGE = "docs/howto/own-planner.md"
BOUND_TOLERANCE = 1e-9
"""Controls may exceed their range by this fraction of it, to allow for rounding."""


@dataclass(frozen=True)
class Plan:
    """A path that a planner has found."""

    controls: Float[np.ndarray, "step control"]
    """One control per physics step, from the start to the goal region."""
    tree: SearchTree | None = None
    """What the search reached, from `query.start`; needed for `--keep-trees`."""


@dataclass(frozen=True)
class Failure:
    """What is known when no plan was found."""

    reason: str
    """Why there is no plan."""
    nearest: float = np.inf
    """Smallest distance to the goal of any state that was reached, in the goal's measure."""
    controls: Float[np.ndarray, "step control"] | None = None
    """The most promising path, if there is one. Polishing may extend it to the goal."""
    tree: SearchTree | None = None
    """What the search reached, as in `Plan`."""


@runtime_checkable
class Planner(Protocol):
    """Finds a path from a start to a goal.

    A planner does not have to shorten its path or to check that the goal can be held: every path is polished
    and then replayed in plain MuJoCo, whichever planner found it.

    A planner may also have:

    - `name: ClassVar[str]`, recorded in datasets. By default its module and class.
    - `default_restarts: ClassVar[int]`, the number of searches per plan unless `PlanConfig.restarts` is set.
      By default 1.
    - `searches_elsewhere: ClassVar[bool]`, True if it simulates in another process. The steps that its plans
      took are then not counted.
    - `check(problem) -> None`, which raises `UsageError` if it cannot plan this problem. It is called once,
      before anything is written.
    """

    def plan(self, query: "Query", rng: np.random.Generator) -> Plan | Failure:
        """Search once.

        Args:
            query: start, goal, problem and simulations.
            rng: the only source of randomness.
        """
        ...


@dataclass(frozen=True)
class FunctionPlanner:
    """A function `plan(query, rng)` as a planner."""

    function: Callable[..., Any]

    @property
    def name(self) -> str:
        """Where the function is defined."""
        return name_of(self.function)

    def plan(self, query: "Query", rng: np.random.Generator) -> Any:
        """Call the function."""
        return self.function(query, rng)


def as_planner(given: Any) -> Planner:
    """Check a planner that was handed over; wrap it if it is a function.

    Raises:
        UsageError: it does not fit the protocol `Planner`.
    """
    is_object = isinstance(given, type) or hasattr(given, "plan")
    if callable(given) and not is_object:
        return FunctionPlanner(given)
    return check_fits(given, Planner, PAGE)


def check_problem(planner: Planner, problem: "Problem") -> None:
    """Let a planner refuse a problem, if it has the optional method `check`.

    Raises:
        UsageError: the planner cannot plan the problem.
        PlanspaceError: something that the planner needs is not installed.
    """
    if (check := getattr(planner, "check", None)) is not None:
        check(problem)


def search(planner: Planner, query: "Query", rng: np.random.Generator) -> Plan | Failure:
    """Search once, and check what the planner returns.

    Raises:
        UsageError: the planner returned something that does not fit the protocol `Planner`.
    """
    found = planner.plan(query, rng)
    if not isinstance(found, Plan | Failure):
        raise _misfit(planner, "must return a Plan or a Failure", quoted(found))
    if found.tree is not None:
        found = replace(found, tree=_checked_tree(planner, found.tree, query))
    if isinstance(found, Plan):
        return replace(found, controls=_checked_controls(planner, found.controls, query))
    try:
        nearest = float(found.nearest)
    except (TypeError, ValueError):
        raise _misfit(planner, "must return a number as Failure.nearest", quoted(found.nearest)) from None
    if found.controls is None:
        return replace(found, nearest=nearest)
    return replace(found, nearest=nearest, controls=_checked_controls(planner, found.controls, query))


def _checked_controls(planner: Planner, given: Any, query: "Query") -> Float[np.ndarray, "step control"]:
    low, high = query.simulator.control_low, query.simulator.control_high
    wanted = f"must return controls of shape (number of physics steps, {len(low)})"
    try:
        controls = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise _misfit(planner, wanted, quoted(given)) from None
    if controls.ndim != 2 or controls.shape[1] != len(low):
        raise _misfit(planner, wanted, f"shape {controls.shape}")
    bad = ~np.isfinite(controls)
    if bad.any():
        step, number = np.argwhere(bad)[0]
        raise _misfit(
            planner,
            "must return finite controls",
            f"{controls[step, number]} in step {step}, number {number}",
        )
    slack = BOUND_TOLERANCE * (high - low)
    outside = (controls < low - slack) | (controls > high + slack)
    if outside.any():
        step, number = np.argwhere(outside)[0]
        raise _misfit(
            planner,
            f"must return controls between {low.tolist()} and {high.tolist()}",
            f"{controls[step, number]:.6g} in step {step}, number {number}",
        )
    return controls


def _checked_tree(planner: Planner, given: Any, query: "Query") -> SearchTree:
    try:
        tree = as_tree(given, len(query.start))
    except ValueError as error:
        raise UsageError(f"Planner {name_of(planner)}: {error}. See {PAGE}.") from None
    if not np.array_equal(tree.states[0], query.start):
        raise _misfit(planner, "must return a tree whose node 0 is query.start", quoted(tree.states[0]))
    return tree


def _misfit(planner: Planner, wanted: str, got: str) -> UsageError:
    return UsageError(f"Planner {name_of(planner)}: plan() {wanted}, got {got}. See {PAGE}.")
