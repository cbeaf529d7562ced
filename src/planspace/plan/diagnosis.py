"""Why a search failed: how far its tree grew, and what stopped the edges that were not valid."""

from collections import Counter

import numpy as np

from planspace.physics.simulator import Simulator
from planspace.plan.tree import Tree

SOFT_LIMITS = 0.1
"""If at least this fraction of the edges leaves the range of one joint, `limit_slack` may help."""
LEAVES_RANGE = "leave the range of"
SMALL_TREE = 1_000
"""With fewer nodes, the tree hardly grew."""


def explain_failure(
    simulator: Simulator, tree: Tree, parents: np.ndarray, controls: np.ndarray, durations: np.ndarray
) -> str:
    """Describe a search that found no path, for a message.

    Args:
        simulator: simulations; overwritten.
        tree: the tree of the search.
        parents: nodes from which edges are tried.
        controls: control of each edge.
        durations: physics steps of each edge.
    """
    causes = Counter(_causes(simulator, tree.states[parents], controls, durations))
    valid = causes.pop("", 0) / len(parents)
    text = f"the tree has {len(tree.costs)} nodes, and {valid:.0%} of its edges are valid"
    if causes:
        cause, count = causes.most_common(1)[0]
        text += f"; {count / len(parents):.0%} {cause}"
        if cause.startswith(LEAVES_RANGE) and count >= SOFT_LIMITS * len(parents):
            text += " (limit_slack accepts soft joint limits)"
    if len(tree.costs) < SMALL_TREE:
        return f"{text}; longer edges (max_edge_s) or a lower sample_velocity may help"
    return f"{text}; more rounds (max_rounds) or another tolerance may help"


def _causes(
    simulator: Simulator, starts: np.ndarray, controls: np.ndarray, durations: np.ndarray
) -> list[str]:
    """What made each edge invalid first; empty for a valid edge."""
    num = len(starts)
    ids, found = np.arange(num, dtype=np.int32), [""] * num
    simulator.reset(starts, ids)
    for step in range(int(durations.max(initial=0))):
        moving = ids[(durations > step) & np.array([not cause for cause in found])]
        if not len(moving):
            break
        simulator.step(controls[moving], ids=moving)
        allowed, diverged, states = (
            simulator.allowed(num),
            simulator.diverged()[:num],
            simulator.states()[:num],
        )
        for i in moving[~allowed[moving] | diverged[moving]].tolist():
            found[i] = _cause(simulator, states[i], bool(diverged[i]))
    return found


def _cause(simulator: Simulator, state: np.ndarray, diverged: bool) -> str:
    space = simulator.space
    if diverged or not np.isfinite(state).all():
        return "diverge (a smaller time step helps)"
    positions, velocities = state[: space.num_positions], state[space.velocities]
    outside = np.flatnonzero((positions < space.low) | (positions > space.high))
    if len(outside):
        return f"{LEAVES_RANGE} {space.names[outside[0]]}"
    if not space.kinematic and (fast := np.flatnonzero(np.abs(velocities) > space.velocity_bound)).size:
        bound = space.velocity_bound[fast[0]]
        return f"exceed the velocity_bound of {space.names[space.num_positions + fast[0]]}, {bound:g}"
    if space.in_bounds(state):
        return "touch a forbidden contact or fail the predicate"
    return f"{LEAVES_RANGE} a ball joint"
