"""`planspace study`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg

from planspace.errors import PartialResult, UsageError


@dataclass(frozen=True)
class Study:
    """Run a study: its embeddings and policies in parallel, then its claims, tables, figures and report."""

    name: Positional[Annotated[str, arg(metavar="NAME")]] = ""
    """paper: the paper's experiments and claims. controls: why an embedding helps. demos: what demonstrations
    must be like. shaping: whether distance in z says which way to go. recipe: how surely the swing-up can be
    learned. Without a name they are listed."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/studies")
    """Where results go: DIR/NAME-BUDGET/report.html, and DIR/units for what each unit found. Studies that
    share DIR share the units they have in common. The same command goes on where one was interrupted."""
    budget: Annotated[str, arg(metavar="{smoke,half,full,paper}")] = "half"
    """Steps a seed. smoke: minutes in all, to see that it works. half: 1 M. full: 2 M. paper: 8 M (2020)."""
    workers: Annotated[int, arg(metavar="N")] = 0
    """Processes, at most one for each core, which 0 takes. The result does not depend on it."""
    seeds: Annotated[int, arg(metavar="N", help_behavior_hint="(default: 15; 25 or 75 where nested)")] = 0
    """Policies an arm, in blocks of 5. A larger number adds to those that were run."""
    only: UseAppendAction[Annotated[tuple[str, ...], arg(metavar="TEXT")]] = ()
    """Only arms whose name (figure/arm) contains this, such as 'swingup, TRPO'; may be given again. The
    report shows all that is there, with --report these arms alone."""
    ray: Annotated[str, arg(metavar="HOST:PORT", help_behavior_hint="(default: this machine)")] = ""
    """A Ray cluster to run the units on (extra `ray`); results come back here. --workers limits how many run
    at a time; 0 takes all of its cores."""
    report: bool = False
    """Run nothing; write the report of what is there."""

    def __call__(self) -> None:
        """Runs what is left of it, writes the report and prints the tables."""
        from planspace.study.grid import STUDIES, make_study
        from planspace.study.report import write_report
        from planspace.study.run import failures
        from planspace.study.summary import as_text, read_findings

        if not self.name:
            raise UsageError(f"which study? There are {', '.join(STUDIES)}.")
        if self.workers < 0:
            raise UsageError("--workers must not be negative.")
        study = make_study(self.name, self.budget, seeds=self.seeds)
        asked = study.only(self.only)
        failed = {} if self.report else self._run(asked)
        text = "".join(f" {line}." for line in failures(failed, study))
        findings = read_findings(asked if self.report else study, self.out)
        if findings.scores or not failed:
            summary, page = write_report(findings, self.out)
            print(f"{as_text(summary)}\n\nreport           {page}")
        if failed:
            raise PartialResult(f"{len(failed)} units failed; what else there is is done.{text}")

    def _run(self, study: Any) -> dict[str, str]:
        from planspace.study.run import run_study

        if not self.ray:
            return run_study(study, self.out, self.workers)
        from planspace.study.cluster import MOST, ray_pool

        return run_study(study, self.out, self.workers or MOST, ray_pool(self.ray))
