"""`planspace run`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from planspace.cli.config_files import check_least
from planspace.errors import PartialResult
from planspace.tasks.catalog import is_problem_file, task_names

TASK_HELP = f"One of {', '.join(task_names())}; or FILE.yaml, your own problem file."


@dataclass(frozen=True)
class Run:
    """Plan, embed, control in plan space and report in one command."""

    task: Positional[Annotated[str, arg(metavar="TASK", help=TASK_HELP)]] = "cartpole-swingup"
    budget: Literal["smoke", "small", "full"] = "small"
    """smoke: under a minute, to see that it works. small: six to eight minutes, a first result. full: 300
    demonstrations, 200 starts, and with --train 15 policies of 2 M steps for each arm."""
    train: bool = False
    """Also train policies with and without z. Added to the command of a finished run, it continues the
    run."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: runs/TASK-BUDGET)")] = None
    """The run's folder. The same command continues an interrupted run."""
    seed: int = 0
    """Seed of every stage. Policies use this seed and the following ones."""

    def __call__(self) -> None:
        """Run every stage and print the summary."""
        from planspace.storage.compiled import use_compilation_cache
        from planspace.study.quickstart import run
        from planspace.study.run_text import as_text, headline

        check_least(self, seed=0)
        use_compilation_cache()
        name = Path(self.task).stem if is_problem_file(self.task) else self.task
        out = self.out or Path("runs") / f"{name}-{self.budget}"
        summary = run(self.task, self.budget, out, self.seed, train=self.train)
        print(as_text(summary))
        print(f"\nreport           {out / 'report.html'}")
        if said := headline(summary.control):
            print(f"\n{said}")
        diverged = f"training diverged: {'; '.join(summary.diverged)}." if summary.diverged else ""
        if problems := " ".join(filter(None, (summary.unsolved, diverged))):
            raise PartialResult(problems)
