"""The result of `train_policies`."""

import html
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from planspace.rl.config import TrainConfig
from planspace.rl.history import EVALUATION, SUCCESS
from planspace.rl.saved_policy import Policy, load_policy
from planspace.seams import name_of
from planspace.storage.arrays import Arrays


class TemporaryFolder:
    """A folder that is removed when nothing refers to this object any more."""

    def __init__(self) -> None:
        """Make the folder."""
        self.path = Path(tempfile.mkdtemp(prefix="planspace-")) / "policies"
        weakref.finalize(self, shutil.rmtree, self.path.parent, ignore_errors=True)


class SeedReturns(NamedTuple):
    """What one seed earned at the end of training."""

    seed: int
    last: float
    """Mean return of the last iteration."""
    evaluation: float
    """Mean return of the deterministic episodes after it."""
    diverged: bool
    """Whether its numbers ceased to be finite; it was then frozen with the policy it had."""
    success: float | None = None
    """Fraction of the deterministic episodes that ended at the goal; None for a Gymnasium environment."""


@dataclass(frozen=True, eq=False, repr=False)
class TrainedPolicies:
    """Policies of all seeds, and the history of their training."""

    task: str
    """The name of the task."""
    config: TrainConfig
    """The settings."""
    history: Arrays
    """`steps` [iteration]; `eval_steps` [evaluation], `eval_return` and `eval_success` [evaluation, seed]; as
    [iteration, seed] `return` and `length` of the episodes, `frozen`, and the algorithm's own numbers."""
    run: Path
    """The run's folder; a temporary one if it was trained in memory."""
    temporary: TemporaryFolder | None = None
    """The run's folder if it was trained in memory; it is removed with the last policy that needs it."""

    def policy(self, seed: int | Literal["best"] = "best") -> Policy:
        """The policy of one seed, or of the seed with the best return in the last evaluation.

        Raises:
            UsageError: that seed was not trained.
        """
        return replace(load_policy(self.run, seed), keeps=self.temporary)

    @property
    def returns(self) -> list[SeedReturns]:
        """What each seed earned at the end."""
        last, evaluation = self.history["return"][-1], self.history[EVALUATION][-1]
        frozen = self.history["frozen"][-1] > 0
        success = self.history[SUCCESS][-1].tolist() if SUCCESS in self.history else [None] * len(last)
        columns = (last.tolist(), evaluation.tolist(), frozen.tolist(), success)
        rows = zip(self.config.seeds, *columns, strict=True)
        return [SeedReturns(*row) for row in rows]

    def __repr__(self) -> str:
        """The task, and the returns over seeds."""
        return "\n".join(self._lines())

    def _repr_html_(self) -> str:
        """The returns of each seed as a table."""
        rows = "".join(
            f"<tr><td>{row.seed}</td><td>{row.last:.1f}</td><td>{row.evaluation:.1f}</td>"
            f"<td>{'' if row.success is None else f'{row.success:.0%}'}</td>"
            f"<td>{'diverged' if row.diverged else ''}</td></tr>"
            for row in self.returns
        )
        names = ("seed", "last iteration", "evaluation", "ended at the goal", "")
        head = f"<tr>{''.join(f'<th>{name}</th>' for name in names)}</tr>"
        return f"<b>{html.escape(self._title())}</b><table>{head}{rows}</table>"

    def _title(self) -> str:
        steps = int(self.history["steps"][-1])
        seeds = f"{self.config.num_seeds} seed{'s' * (self.config.num_seeds > 1)}"
        return f"TrainedPolicies: {self.task}, {name_of(self.config.algorithm)}, {seeds}, {steps:,} steps"

    def _lines(self) -> Iterator[str]:
        yield self._title()
        for name, numbers in (
            ("last iteration", self.history["return"][-1]),
            ("evaluation", self.history[EVALUATION][-1]),
        ):
            spread = f"mean {np.mean(numbers):.1f}, worst {np.min(numbers):.1f}, best {np.max(numbers):.1f}"
            yield f"return, {name}: {spread}"
        if SUCCESS in self.history:
            numbers = self.history[SUCCESS][-1]
            spread = f"mean {np.mean(numbers):.0%}, worst {np.min(numbers):.0%}, best {np.max(numbers):.0%}"
            yield f"ended at the goal, evaluation: {spread}"
        if diverged := [str(row.seed) for row in self.returns if row.diverged]:
            yield f"diverged: seed {', '.join(diverged)}"
