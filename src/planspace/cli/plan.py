"""`planspace plan`."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from planspace.errors import UsageError, unknown


@dataclass(frozen=True)
class Plan:
    """Plan demonstrations from random starts to a goal."""

    out: Annotated[Path, arg(metavar="DIR")]
    """The dataset folder. The same command continues an interrupted one; a larger --num adds to it."""
    problem: Positional[Annotated[str, arg(metavar="PROBLEM|FILE.yaml")]] = ""
    """A shipped problem's name, or a problem file; without it the names are listed."""
    num: Annotated[int, arg(metavar="N")] = 100
    """How many demonstrations."""
    seed: int = 0
    """Seed of starts, goals and planner."""
    workers: Annotated[int, arg(metavar="N")] = 0
    """Processes; 0 takes one for each CPU. The result does not depend on it."""
    planner: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: the problem's, sst)")] = ""
    """sst is ours. OMPL's are ompl-sst, ompl-rrt, ompl-est, ompl-kpiece1, ompl-pdst,
    and for kinematic problems ompl-rrtconnect, ompl-rrtstar, ompl-prm, ompl-bitstar."""
    cost: Annotated[str, arg(metavar="COST", help_behavior_hint="(default: the problem's, duration)")] = ""
    """What makes a plan good: duration, or effort."""
    restarts: Annotated[int, arg(metavar="N", help_behavior_hint="(default: the problem's, 2)")] = 0
    """Independent searches for each plan, the best of which is kept (one with OMPL)."""
    polish: bool = True
    """Shorten each plan and land it on its goal; --no-polish keeps what the planner found."""
    seconds: Annotated[float, arg(metavar="S", help_behavior_hint="(default: count rounds; OMPL 20)")] = 0.0
    """Time for each search. Counting rounds instead makes the same plans on every machine."""
    settings: UseAppendAction[Annotated[tuple[str, ...], arg(metavar="KEY=VALUE")]] = ()
    """Further settings of the planner, such as min_rounds=60, polish_max_blocks=100, ompl_goal_bias=0.2."""
    untrusted: bool = False
    """The model comes from strangers: read it in a process of its own, in bounded memory and time."""

    def __call__(self) -> None:
        """Plans and says what came of it."""
        from planspace.plan.config import PlanConfig
        from planspace.plan.demonstrations import plan_into
        from planspace.tasks.problem_file import load_problem, shipped_problems

        if not self.problem:
            raise UsageError(f"which problem? Shipped: {', '.join(shipped_problems())}; or a FILE.yaml.")
        if self.num < 1 or min(self.restarts, self.seconds, self.workers, self.seed) < 0:
            raise UsageError(
                "--num must be at least 1; --restarts, --seconds, --workers and --seed must not be negative."
            )
        problem = load_problem(self.problem, untrusted=self.untrusted)
        if self.cost not in ("", "duration", "effort"):
            raise unknown("cost", self.cost, ["duration", "effort"])
        problem = replace(problem, cost=self.cost) if self.cost else problem
        seconds = self.seconds or None
        changes = {
            "planner": self.planner or None,
            "restarts": self.restarts or None,
            "sst_seconds": seconds,
            "ompl_seconds": seconds,
            "polish_max_iterations": None if self.polish else 0,
        }
        changes |= dict(map(_setting, self.settings))
        config = PlanConfig.for_problem(problem, **changes)
        folder = plan_into(
            problem, self.out, num=self.num, seed=self.seed, config=config, workers=self.workers or None
        )
        print(f"{folder.num_episodes} demonstrations in {self.out}")


def _setting(text: str) -> tuple[str, float]:
    """`KEY=VALUE` taken apart."""
    key, _, value = text.partition("=")
    try:
        return key, float(value)
    except ValueError:
        raise UsageError(f"--settings takes KEY=VALUE with a number, got {text!r}.") from None
