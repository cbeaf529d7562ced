"""`planspace plan`."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from planspace.cli.config_files import (
    ConfigFile,
    check_least,
    given_config,
    given_option,
    group_in_file,
    load_or_name,
    named_in_file,
    with_settings,
)
from planspace.cli.tables import counted
from planspace.errors import UsageError
from planspace.mjcf.assets import ASSETS
from planspace.plan.config import PlanConfig, find_planner
from planspace.tasks.dm_control.suite import DMC_PREFIX

if TYPE_CHECKING:
    from planspace.embed.planning_metric import PlanningMetric
    from planspace.tasks.problem import Problem

PROBLEMS = sorted(path.stem for path in ASSETS.glob("*.yaml"))
PATH_OPTIONS = ("--config", "--out", "--planner", "--metric")
"""Options whose values could look like the problem."""
PROBLEM_HELP = (
    f"One of {', '.join(PROBLEMS)}; dmc:NAME, a task of DeepMind Control; or the path of your own problem "
    "file."
)


@dataclass(frozen=True)
class Plan:
    """Plan demonstrations from random starts to a goal.

    The settings of the planner, the polish and the regulator are options, too. Their defaults are those of
    the problem.
    """

    problem: Positional[
        Annotated[str, arg(metavar="PROBLEM|FILE.yaml", help=PROBLEM_HELP, help_behavior_hint="(required)")]
    ] = ""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(required)")] = None
    """The dataset folder. The same command continues an interrupted one; a larger --num adds to it."""
    num: Annotated[int, arg(metavar="N")] = 100
    """Number of demonstrations."""
    seed: int = 0
    """Seed of starts, goals and searches."""
    workers: Annotated[int, arg(metavar="N")] = 0
    """Worker processes; 0 starts one for each CPU. The result does not depend on this number."""
    planner: Annotated[
        str, arg(metavar="NAME|module.py:NAME", help_behavior_hint="(default: the problem's, sst)")
    ] = ""
    """sst; or with the extra `ompl`: ompl-sst, ompl-rrt, ompl-est, ompl-kpiece1, ompl-pdst, and for kinematic
    problems ompl-rrtconnect, ompl-rrtstar, ompl-prm, ompl-bitstar; or module.py:NAME for your own."""
    cost: Annotated[
        Literal["duration", "effort"] | None,
        arg(metavar="{duration,effort}", help_behavior_hint="(default: the problem's, duration)"),
    ] = None
    """What plans are compared and shortened by."""
    metric: Annotated[Path | None, arg(metavar="EMBEDDING", help_behavior_hint="(default: none)")] = None
    """An embedding of the same joints: sst extends the nodes nearest to the goal more often, by the time to
    go or, without a time head, by the distance in z."""
    no_polish: bool = False
    """Keep what the planner found, instead of shortening each plan and landing it on its goal."""
    settings: UseAppendAction[Annotated[tuple[str, ...], arg(metavar="KEY=VALUE")]] = ()
    """Settings by the names that problem files use, such as polish_max_blocks=100 or ompl_goal_bias=0.2."""
    untrusted: bool = False
    """The model comes from someone you do not trust: read it in a separate process with limited memory and
    time."""
    config_file: ConfigFile = None
    config: PlanConfig = field(default_factory=PlanConfig)

    @classmethod
    def default(cls, arguments: Sequence[str]) -> "Plan":
        """The defaults of the problem, and the settings that --planner, --settings and --config ask for."""
        from planspace.tasks.problem_file import load_problem

        path, file = given_config(arguments)
        if "config" in (recorded := group_in_file(file, "settings", path)):  # the manifest of a dataset
            file = group_in_file(recorded, "config", path)
        planner = given_option(arguments, "--planner") or named_in_file(file, "planner", path)
        chosen = None if planner is None else find_planner(load_or_name(planner))
        config = PlanConfig() if chosen is None else PlanConfig(chosen)
        if problem := _named_problem(arguments):
            given = dict(map(_setting, _given_settings(arguments)))
            loaded = load_problem(problem, untrusted="--untrusted" in arguments)
            config = PlanConfig.for_problem(loaded, planner=chosen, **given)
        if path:
            config = with_settings(config, file, path)
        return cls(config=config)

    def __call__(self) -> None:
        """Plan, and print how many demonstrations there are."""
        from planspace.plan.demonstrations import plan_into
        from planspace.tasks.problem_file import load_problem

        if not self.problem:
            raise UsageError(f"which problem? {PROBLEM_HELP}")
        if self.out is None:
            raise UsageError("`--out DIR` is required: the folder of the dataset.")
        check_least(self, num=1, workers=0, seed=0)
        problem = load_problem(self.problem, untrusted=self.untrusted)
        if self.cost is not None:
            problem = replace(problem, cost=self.cost)
        if held := [name for name, _ in problem.source.held]:
            print(f"held, because they are not in joints: {', '.join(held)}", file=sys.stderr)
        config = self.config
        if self.no_polish:
            config = replace(config, polish=replace(config.polish, max_iterations=0))
        if self.metric is not None:
            config = replace(config, metric=_metric(self.metric, problem))
        folder = plan_into(
            problem, self.out, num=self.num, seed=self.seed, config=config, workers=self.workers or None
        )
        print(f"{counted(folder.num_episodes, 'demonstration')} in {self.out}")


def _metric(folder: Path, problem: "Problem") -> "PlanningMetric":
    """The metric of an embedding's folder, for states of a problem."""
    from planspace.embed.planning_metric import PlanningMetric
    from planspace.embed.saved_embedding import load_embedding

    embedding = load_embedding(folder)
    space = problem.compile()[1]
    return PlanningMetric(embedding, embedding.columns_of(space.names, space.units))


def _named_problem(arguments: Sequence[str]) -> str | None:
    """The problem that a command line names, found before its options are parsed."""
    for position, argument in enumerate(arguments):
        is_option_value = position > 0 and arguments[position - 1] in PATH_OPTIONS
        is_named = argument in PROBLEMS or argument.startswith(DMC_PREFIX)
        if not is_option_value and (is_named or argument.endswith((".yaml", ".yml"))):
            return argument
    return None


def _given_settings(arguments: Sequence[str]) -> list[str]:
    return [value for option, value in pairwise(arguments) if option == "--settings"]


def _setting(text: str) -> tuple[str, float]:
    """Split `KEY=VALUE`."""
    key, _, value = text.partition("=")
    try:
        return key, float(value)
    except ValueError:
        raise UsageError(f"`--settings` takes KEY=VALUE with a number, got {text!r}.") from None
