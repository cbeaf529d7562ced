"""The summary of a `planspace run` as text for a terminal."""

from collections.abc import Iterator

from planspace.study.run_control import COST_NAMES, ControlResults
from planspace.study.run_summary import FINAL_ITERATIONS, GEOMETRY_ROWS, RunSummary


def as_text(summary: RunSummary) -> str:
    """The summary as text, without its headline."""
    parts = (_head(summary), _geometry(summary), _horizons(summary.control), _returns(summary))
    return "\n\n".join("\n".join(lines) for lines in map(list, parts) if lines)


def headline(control: ControlResults) -> str:
    """The difference of success between z and raw distance in one sentence; empty if there is none."""
    if (found := control.reached) is None:
        return ""
    low, high = found.interval
    return (
        f"Looking {found.horizon_s:g} s ahead, control by distance in z succeeds from {found.z} of "
        f"{found.starts} starts and by raw distance from {found.raw}: {100 * found.difference:+.0f} "
        f"percentage points (95 % interval {100 * low:+.0f} to {100 * high:+.0f})."
    )


def _head(summary: RunSummary) -> Iterator[str]:
    demos = summary.demos
    yield f"{summary.task}, budget {summary.budget}, seed {summary.seed}"
    yield ""
    yield (
        f"demonstrations   {demos.count} planned, {demos.at_goal} of them end at the goal, median duration "
        f"{demos.median_duration_s:.2f} s"
    )


def _geometry(summary: RunSummary) -> Iterator[str]:
    geometry = summary.geometry
    yield f"geometry on {geometry.embedding['num_demos']} test demos    z     raw state"
    for key, name, hint in GEOMETRY_ROWS:
        z, raw = metric(geometry.embedding[key]), metric(geometry.raw_state[key])
        yield f"  {name:<22}{z:>8}{raw:>12}   {hint}"


def _horizons(control: ControlResults) -> Iterator[str]:
    if control.by_horizon:
        horizons = "".join(f"{f'{h:g} s':>9}" for h in control.horizons)
        yield f"success of control, {control.horizon_starts} starts{horizons}"
    for cost, counts in control.by_horizon:
        fractions = "".join(f"{count / control.horizon_starts:>9.0%}" for count in counts)
        yield f"  {COST_NAMES[cost]:<28}{fractions}"
    yield from control.notes


def _returns(summary: RunSummary) -> Iterator[str]:
    if summary.arms:
        yield f"return of TRPO, last {FINAL_ITERATIONS} iterations    mean     worst      best   seeds"
    for label, arm in summary.arms.items():
        yield f"  {label:<28}{arm.mean:>12.1f}{arm.worst:>10.1f}{arm.best:>10.1f}{arm.seeds:>8}"
    yield from summary.verdicts


def metric(value: float | None) -> str:
    """A metric with three decimals; `-` if too few demonstrations define it."""
    return "-" if value is None else f"{value:.3f}"
