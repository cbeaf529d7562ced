"""`planspace control`."""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, Suppress, arg

from planspace.cli.config_files import (
    ConfigFile,
    check_least,
    given_config,
    given_option,
    load_or_name,
    named_in_file,
    refuse_inputs,
    whole_in_file,
    with_settings,
)
from planspace.cli.tables import counted, print_json, print_values
from planspace.control.config import ControlConfig
from planspace.control.methods import METHODS
from planspace.errors import UsageError, unknown
from planspace.tasks.catalog import task_names

if TYPE_CHECKING:
    from planspace.control.plant import Plant
    from planspace.control.runs import ControlSummary
    from planspace.demos.state_info import StateInfo

HELP = (
    f"One of {', '.join(task_names())}; dmc:NAME; or the path of your own problem file. A name "
    "of both a task and a problem means the task."
)
IN_TIME = 0.99
"""Fraction of control steps above which a run counts as real time."""
RECORDED = (
    "task",
    "task_sha256",
    "problem",
    "embedding",
    "seed",
    "episode_steps",
    "versions",
    "pixels",
    "plans",
    "starts",
)
"""What a run's config.json records besides settings."""


@dataclass(frozen=True)
class Control:
    """Steer a robot to its goal by looking ahead, with the distance in z as the cost.

    No policy is trained and no reward is used: for each control, many candidates are simulated for a fraction
    of a second, and a mean is applied in which those that come nearest to the goal in z weigh most.
    """

    problem: Positional[
        Annotated[str, arg(metavar="PROBLEM|TASK|FILE.yaml", help=HELP, help_behavior_hint="(required)")]
    ] = ""
    embedding: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """The embedding folder, or the name of a ready-made one; needed for --cost z."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(required)")] = None
    """The run's folder. The same command continues an interrupted run; a larger --episodes adds to it."""
    pixels: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """An encoder of `planspace pixels`. The controller then sees pictures only: it looks ahead from the state
    that the encoder estimates and a Kalman filter joins. --embedding is its teacher by default."""
    episodes: Annotated[int, arg(metavar="N")] = 10
    """Number of episodes."""
    episode_s: Annotated[float | None, arg(metavar="S", help_behavior_hint="(default: the task's)")] = None
    """Length of an episode [s]."""
    seed: int = 0
    """Seed of starts, goals and samples."""
    workers: Annotated[int, arg(metavar="N")] = 0
    """Worker processes, each of which runs an episode on one core; 0 starts one for each CPU. The result does
    not depend on this number."""
    method: Annotated[str, arg(metavar="{" + ",".join(METHODS) + "}|module.py:NAME")] = "mppi"
    """How samples become controls, or module.py:NAME for your own. Its settings are options, too."""
    plans: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """A dataset of plans: shown beside the episodes in the film and in the report, and followed with
    --follow-s."""
    no_film: bool = False
    """Do not film the episodes."""
    json: bool = False
    """Print JSON."""
    config_file: ConfigFile = None
    config: ControlConfig = field(default_factory=ControlConfig)
    recorded: Annotated[tuple[str, int], Suppress] = ("", 0)
    """The task and its steps in an episode, as the file of `--config` says."""

    @classmethod
    def default(cls, arguments: Sequence[str]) -> "Control":
        """The defaults that --method and --config ask for."""
        path, file = given_config(arguments)
        method = given_option(arguments, "--method") or named_in_file(file, "method", path) or "mppi"
        named = load_or_name(method)
        if isinstance(named, str) and named not in METHODS:
            raise unknown("method", named, METHODS)
        config = ControlConfig(METHODS[named] if isinstance(named, str) else named)
        if path:
            config = with_settings(config, file, path, ignored=RECORDED)
            refuse_inputs(file, path, embedding="--embedding DIR", pixels="--pixels DIR", plans="--plans DIR")
            if "starts" in file:
                raise UsageError(
                    f"{path} is of episodes whose starts were given from Python: repeat it there."
                )
        seed, steps = whole_in_file(file, "seed", path, 0), whole_in_file(file, "episode_steps", path, 1)
        recorded = str(file.get("task")), (steps or 0) * config.action_repeat
        return cls(method=method, config=config, seed=seed or 0, recorded=recorded)

    def __call__(self) -> None:
        """Control the episodes, film them, and print what they amount to."""
        from planspace.control.costs import support_note
        from planspace.control.plant import Plant
        from planspace.control.runs import control_into
        from planspace.demos.load import load_demos
        from planspace.embed.pixels.saved import load_image_encoder
        from planspace.embed.saved_embedding import load_embedding
        from planspace.study.control_report import write_control_report

        if not self.problem:
            raise UsageError(f"which problem? {HELP}")
        if self.out is None:
            raise UsageError("`--out DIR` is required: the folder of the run.")
        check_least(self, episodes=1, workers=0, seed=0)
        plant = Plant.find(load_or_name(self.problem))
        embedding = None if self.embedding is None else load_embedding(self.embedding)
        encoder = None if self.pixels is None else load_image_encoder(self.pixels)
        if embedding is None and encoder is not None:
            embedding = encoder.teacher
        plans = None if self.plans is None else load_demos(self.plans)
        episode_s = self.episode_s
        task, steps = self.recorded
        if episode_s is None and steps and task == plant.task.name:
            episode_s = steps * plant.control_step
        if plans is not None:
            self._check_plans(plans.info, plant)
        if self.config.follow_s and plans is None:
            raise UsageError("--follow-s needs plans to follow: give --plans DIR.")
        if note := support_note(plant, self.config, embedding):
            print(note, file=sys.stderr)
        found = control_into(
            plant,
            embedding,
            self.config,
            self.out,
            num=self.episodes,
            seed=self.seed,
            episode_s=episode_s,
            workers=self.workers or None,
            encoder=encoder,
            plans=plans,
        )
        self._print(found)
        report = write_control_report(self.out, found, self.config, embedding, plans, film=not self.no_film)
        if not self.json:
            print(report)

    def _check_plans(self, info: "StateInfo", plant: "Plant") -> None:
        """Refuse plans with other states, and warn of plans of another problem that are to be followed.

        Raises:
            UsageError: the plans have other states.
        """
        name = plant.problem.name
        if info.names != plant.space.names:
            raise UsageError(
                f"{self.plans} has the states ({', '.join(info.names)}), but {name} has "
                f"({', '.join(plant.space.names)}): give plans of {name}."
            )
        if self.config.follow_s and info.problem not in ("", name):
            print(
                f"the plans are of {info.problem}, not of {name}: where none leads to the goal, none is "
                "followed.",
                file=sys.stderr,
            )

    def _print(self, found: "ControlSummary") -> None:
        if self.json:
            print_json(asdict(found))
            return
        print(f"{counted(found.episodes, 'episode')} in {self.out}")
        print_values({key: value for key, value in asdict(found).items() if key != "episodes"})
        if found.real_time < IN_TIME:
            print(
                f"{1 - found.real_time:.0%} of the controls took longer to compute than they lasted; "
                "fewer --samples or a shorter --horizon-s are faster."
            )
