"""`planspace study`."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from planspace.cli.config_files import load_or_name
from planspace.cli.tables import counted
from planspace.errors import PartialResult, UsageError

if TYPE_CHECKING:
    from planspace.study.design import Study as StudyDesign


@dataclass(frozen=True)
class Study:
    """Run a study: many embeddings and policies, statistics and a report.

    The embeddings and policies are trained in parallel. Then claims are judged, and tables, figures and a
    report are written.
    """

    name: Positional[Annotated[str, arg(metavar="NAME", help_behavior_hint="(required)")]] = ""
    """paper: the paper's experiments and claims. controls: why an embedding helps. demos: what demonstrations
    an embedding needs. shaping: whether distance in z works as a shaping reward. recipe: how reliably the
    swing-up is learned. uses: which ways to use plans in training help."""
    task: Positional[
        Annotated[str, arg(metavar="[TASK]", help_behavior_hint="(default: the study's own)")]
    ] = ""
    """For recipe, controls and uses: another task. The name of a shipped task or planning problem; FILE.yaml,
    your own problem file; or module.py:NAME, your own Task."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/studies")
    """Folder of the results: DIR/NAME-BUDGET/report.html (for another task DIR/NAME-TASK-HASH-BUDGET), and
    DIR/units with the result of each unit. Studies with the same DIR share their common units. The same
    command resumes an interrupted study."""
    budget: Annotated[str, arg(metavar="{smoke,half,full,paper}")] = "half"
    """Environment steps per seed. smoke: a few minutes in all, to see that it works. half: 1 M. full: 2 M.
    paper: 8 M, as in 2020. SAC, in uses, takes a tenth of them."""
    workers: Annotated[int, arg(metavar="N")] = 0
    """Worker processes, at most one per core; 0 uses every core. The result does not depend on this
    number."""
    seeds: Annotated[
        int | None, arg(metavar="N", help_behavior_hint="(default: 15; some arms of demos 25, of recipe 75)")
    ] = None
    """Policies per arm, a multiple of 5. A larger number adds seeds; finished seeds are not run again."""
    only: UseAppendAction[Annotated[tuple[str, ...], arg(metavar="TEXT")]] = ()
    """Run only arms whose name (figure/arm) contains this text, such as 'swingup, TRPO'. The
    report shows every arm that has results; with --report it shows only these arms."""
    ray: Annotated[str, arg(metavar="HOST:PORT", help_behavior_hint="(default: this machine)")] = ""
    """A Ray cluster to run the units on (extra `ray`). Results are stored on this machine. --workers limits
    how many units run at a time; 0 uses every core of the cluster."""
    report: bool = False
    """Write the report of the existing results, without running any units."""
    shard: Annotated[str, arg(metavar="I/N", help_behavior_hint="(default: the whole study)")] = ""
    """Run only part I of N of the study, such as 2/3, on a machine of its own. The results are stored in
    DIR/NAME-BUDGET-shard-I-of-N. The shards take about the same time."""
    merge: Annotated[
        tuple[Path, ...] | None, arg(metavar="SHARD...", help_behavior_hint="(default: none)")
    ] = None
    """The folders of all shards. Copy their results to DIR and write the report, as if the study had been
    run in one piece. Give the other options as for the shards."""
    slurm: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: none)")] = None
    """Print the script of a Slurm job array that runs the study in N shards. Nothing is run."""

    def __call__(self) -> None:
        """Run the units that are missing, write the report and print the tables."""
        from planspace.study.grid import BLOCK, STUDIES, make_study

        if not self.name:
            raise UsageError(f"which study? Choose one of {', '.join(STUDIES)}.")
        if self.workers < 0:
            raise UsageError(f"`--workers` must be 0 or more, got {self.workers}.")
        self._check_mode()
        if self.seeds == 0:
            raise UsageError(f"`--seeds` must be a positive multiple of {BLOCK}, got 0.")
        study = make_study(self.name, self.budget, seeds=self.seeds or 0, task=load_or_name(self.task))
        study = replace(study, task=self.task)
        selected = study.only(self.only)
        if self.slurm is not None:
            from planspace.study.slurm import slurm_script

            print(slurm_script(selected, self.slurm, self.out, self.workers), end="")
        elif self.shard:
            self._run_shard(selected)
        else:
            self._run_whole(study, selected)

    def _check_mode(self) -> None:
        """Check that at most one option says what to do instead of running the whole study."""
        from planspace.study.shards import Shard

        modes = {
            "--report": self.report,
            "--shard": bool(self.shard),
            "--merge": self.merge is not None,
            "--slurm": self.slurm is not None,
        }
        given = [name for name, is_given in modes.items() if is_given]
        if len(given) > 1:
            raise UsageError(f"{' and '.join(given)} cannot be used together.")
        if self.ray and self.slurm is not None:
            raise UsageError("--ray and --slurm cannot be used together.")
        if self.merge == ():
            raise UsageError("`--merge` needs the folders of the shards.")
        if self.shard:
            Shard.parse(self.shard)

    def _run_whole(self, study: "StudyDesign", selected: "StudyDesign") -> None:
        from planspace.study.report import write_report
        from planspace.study.run import failures
        from planspace.study.shards import merge_shards
        from planspace.study.summary import read_findings
        from planspace.study.tables import as_text

        failed = {}
        if self.merge:
            merge_shards(selected, self.merge, self.out)
        elif not self.report:
            failed = self._run(selected, self.out)
        text = "".join(f" {line}." for line in failures(failed, study))
        findings = read_findings(study, self.out)
        if self.report:
            findings = findings.of(selected)
        if findings.scores or not failed:
            summary, page = write_report(findings, self.out)
            print(f"{as_text(summary)}\n\nreport           {page}")
        if failed:
            raise PartialResult(f"{counted(len(failed), 'unit')} failed; the other results are saved.{text}")

    def _run_shard(self, study: "StudyDesign") -> None:
        from planspace.study.run import failures
        from planspace.study.shards import Shard, divide, open_shard

        shard = Shard.parse(self.shard)
        part = divide(study, shard.count)[shard.index - 1]
        folder = open_shard(study, shard, self.out)
        if failed := self._run(part, folder):
            text = "".join(f" {line}." for line in failures(failed, part))
            raise PartialResult(f"{counted(len(failed), 'unit')} failed; the other results are saved.{text}")
        print(f"{shard}, {counted(len(part.units), 'unit')}: {folder}")

    def _run(self, study: "StudyDesign", out: Path) -> dict[str, str]:
        from planspace.study.run import run_study

        if not self.ray:
            return run_study(study, out, self.workers)
        from planspace.study.cluster import NO_LIMIT, ray_pool

        return run_study(study, out, self.workers or NO_LIMIT, ray_pool(self.ray))
