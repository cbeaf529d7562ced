"""The tables of a study: declared types, and text for a terminal."""

from collections.abc import Mapping
from dataclasses import dataclass

from planspace.rl.config import BATCH_STEPS
from planspace.study import stats
from planspace.study.design import Claim
from planspace.study.results import Metrics
from planspace.study.stats import Interval

NOT_RUN = "not run yet"
"""The verdict on a claim about an arm without results."""
MAX_UNDECIDED = 10
"""With more undecided claims than this, a terminal shows their number only."""
Estimate = tuple[float, Interval]
"""A number and its 95 % interval."""


@dataclass(frozen=True)
class ArmRow:
    """A row of a figure's table: the final returns of an arm's seeds."""

    arm: str
    seeds: int
    """Number of seeds that have been run."""
    planned: int
    """Number of seeds that the study plans for the arm."""
    embeddings: int
    diverged: int
    """Number of seeds that diverged."""
    mean: float
    mean_interval: Interval
    iqm: float
    """Interquartile mean."""
    iqm_interval: Interval
    worst: float
    best: float
    standard_deviation: float
    ratio: Estimate | None
    """Standard deviation of the first arm divided by this one's."""
    improvement: Estimate | None
    """Probability that a seed of this arm is better than a seed of the first arm."""
    whole: float
    """Mean return over the whole training."""
    solved: float | None
    """Fraction of seeds that solved the task; None for a reward without a level."""
    steps_to_solved: float | None
    """Steps until half of the seeds had solved the task."""
    components: tuple[float, float] | None
    """Standard deviation between embeddings, and between seeds of one embedding."""


@dataclass(frozen=True)
class OverTasksRow:
    """Returns of an arm over all tasks. Each task is normalised: 0 is an idle policy, 1 is solved."""

    algo: str
    arm: str
    tasks: int
    iqm: float
    iqm_interval: Interval


@dataclass(frozen=True)
class ClaimRow:
    """A claim and its verdict."""

    claim: Claim
    rule: str
    """The condition under which the claim holds, in words."""
    number: float | None
    """None if it cannot be computed yet."""
    interval: Interval | None
    seeds: int
    """Number of seeds that decided the claim."""
    verdict: str


@dataclass(frozen=True)
class EmbeddingRow:
    """The geometry of an embedding on test demonstrations."""

    name: str
    demos: int
    """Number of demonstrations: training, validation and test together."""
    z_dim: int
    seed: int
    metrics: Metrics


@dataclass(frozen=True)
class PlansRow:
    """A dataset of demonstrations."""

    problem: str
    source: str
    settings: Mapping[str, int | float]
    count: int
    reached: float
    median_duration_s: float
    simulated_steps: int | None
    """Physics steps that planner or control took; None if not counted."""


@dataclass(frozen=True)
class CostRow:
    """What an arm takes."""

    panel: str
    arm: str
    steps: int
    """Environment steps per seed."""
    seed_core_seconds: float | None
    """Core seconds per seed of training policies; None if not timed."""
    needs_core_seconds: float | None
    """Core seconds of demonstrations and embeddings, which other arms may share; None if not timed."""
    simulated_steps: int | None
    """Physics steps of planner and control; None if not counted."""


@dataclass(frozen=True)
class Time:
    """Core seconds of a study."""

    timed_units: int
    timed_core_seconds: int
    whole_core_seconds: int
    """Estimate for the whole study."""
    not_timed: int
    """Number of units whose kind has no timed unit yet."""


@dataclass(frozen=True)
class StudySummary:
    """The tables of a study."""

    study: str
    budget: str
    steps: int
    """Environment steps per seed, the largest number of any arm."""
    least_steps: int
    """The smallest number."""
    evaluated: bool
    """Whether returns are those of evaluations."""
    question: str
    units_done: int
    units_all: int
    panels: Mapping[str, list[ArmRow]]
    """The rows of each figure. The other arms are compared with the first."""
    over_tasks: list[OverTasksRow]
    claims: list[ClaimRow]
    embeddings: list[EmbeddingRow]
    plans: list[PlansRow]
    costs: list[CostRow]
    time: Time

    @property
    def steps_text(self) -> str:
        """Environment steps per seed: 1,000,000, or 100,000 to 1,000,000."""
        low, high = (f"{steps:,}" for steps in (self.least_steps, self.steps))
        return high if low == high else f"{low} to {high}"


def _final_text(summary: StudySummary) -> str:
    if summary.evaluated:
        return "return of the last evaluations"
    return f"return over the last {stats.FINAL_STEPS // BATCH_STEPS} iterations"


def as_text(summary: StudySummary) -> str:
    """The tables as text for a terminal."""
    lines = [
        f"study {summary.study}, budget {summary.budget}: {summary.units_done} of {summary.units_all} units"
    ]
    for panel, rows in summary.panels.items():
        head = f"{panel}: {_final_text(summary)}"
        lines += ["", f"{head:<64}{'mean':>9}{'95 % interval':>20}{'worst':>9}{'best':>9}{'seeds':>7}"]
        for row in rows:
            low, high = row.mean_interval
            line = f"  {row.arm:<62}{row.mean:>9.1f}{f'({low:.1f}, {high:.1f})':>20}"
            lines.append(f"{line}{row.worst:>9.1f}{row.best:>9.1f}{row.seeds:>7}")
    if summary.claims:
        lines += ["", f"{'claim':<82}{'number':>9}{'95 % interval':>20}  verdict"]
    undecided = [row for row in summary.claims if row.verdict in (stats.OPEN, NOT_RUN)]
    hidden = undecided if len(undecided) > MAX_UNDECIDED else []
    for row in (row for row in summary.claims if row not in hidden):
        if row.number is None or row.interval is None:
            lines.append(f"  {row.claim.text:<80}{'':>29}  {row.verdict}")
            continue
        low, high = row.interval
        number = f"{row.number:>9.2f}{f'({low:.2f}, {high:.2f})':>20}"
        lines.append(f"  {row.claim.text:<80}{number}  {row.verdict}")
    if hidden:
        lines.append(
            f"  {len(hidden)} claims are not decided by these seeds, or were not run; see the report"
        )
    return "\n".join(lines)
