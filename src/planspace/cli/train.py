"""`planspace train`."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from planspace.cli.config_files import (
    ConfigFile,
    given_config,
    given_name,
    given_option,
    load_or_name,
    named_in_file,
    refuse_inputs,
    with_settings,
)
from planspace.errors import PartialResult, UsageError
from planspace.rl.algorithm import HOW_TO, Algorithm
from planspace.rl.algorithms import ALGORITHMS, find_algorithm
from planspace.rl.config import TrainConfig
from planspace.rl.saved_settings import read_settings
from planspace.seams import check_fits
from planspace.storage.tracking import TrackerName
from planspace.tasks.catalog import task_names
from planspace.tasks.gymnasium import AnyTask, GymTask, find_training_task

if TYPE_CHECKING:
    from planspace.rl.trained import TrainedPolicies

RECORDED = ("task", "task_sha256", "environment", "embeddings", "plans", "versions", "preset")
"""What a run's config.json records besides settings."""
GYM_HELP = (
    "Gymnasium steps its environments one after another, which is slower than planspace's own tasks; "
    "--env-workers shares them among processes."
)
TASK_HELP = (
    f"One of {', '.join(task_names())}; FILE.yaml, your own problem file; dmc:NAME, a task of DeepMind "
    "Control; gym:ID, a Gymnasium environment; "
    f"or module.py:NAME, your own Task or GymTask. {GYM_HELP}"
)


@dataclass(frozen=True)
class Train:
    """Train policies on a task, all seeds at once."""

    task: Positional[Annotated[str, arg(metavar="TASK", help=TASK_HELP, help_behavior_hint="(required)")]] = (
        ""
    )
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(required)")] = None
    """The run's folder. The same command continues an interrupted run."""
    algo: Annotated[str, arg(metavar="{" + ",".join(ALGORITHMS) + "}|module.py:NAME")] = "trpo"
    """The algorithm, or module.py:NAME for your own. Its settings are options, too."""
    preset: Annotated[str, arg(metavar="{paper,modern}")] = "paper"
    """Defaults of the algorithm's settings. paper: the paper and the runs of 2020. modern: standardised
    observations, a value beyond the time limit, minibatches of steps for PPO, and normalised layers of SAC's
    critics."""
    embedding: Annotated[tuple[Path, ...], arg(metavar="DIR ...", help_behavior_hint="(default: none)")] = ()
    """Embedding folders, or names of ready-made ones, that provide z. With several, seed s uses number s
    modulo their count, so that the spread over seeds includes the spread over embeddings."""
    plans: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """A dataset of plans, for --resets, --replay, --clone and --clone-weight."""
    env_workers: Annotated[int, arg(metavar="N")] = 0
    """Processes that step a Gymnasium environment (gym:ID). 0 steps it in this process; the results are the
    same."""
    track: UseAppendAction[Annotated[tuple[TrackerName, ...], arg(metavar="{tensorboard,wandb}")]] = ()
    """Also write the curves for TensorBoard (DIR/tensorboard) or Weights & Biases (extra `track`). W&B works
    offline in DIR/wandb unless you are logged in. history.safetensors and log.jsonl are always written."""
    config_file: ConfigFile = None
    config: TrainConfig = field(default_factory=TrainConfig)

    @classmethod
    def default(cls, arguments: Sequence[str]) -> "Train":
        """The defaults that --algo, --preset and --config ask for."""
        path, file = given_config(arguments)
        algo = given_option(arguments, "--algo") or named_in_file(file, "algorithm", path) or "trpo"
        preset = given_name(arguments, file, "preset", path) or "paper"
        named = load_or_name(algo)
        algorithm = find_algorithm(named, preset) if isinstance(named, str) else named
        config = TrainConfig(check_fits(algorithm, Algorithm, HOW_TO))
        if "learner" in file:  # written by version 0.1.0
            _, config = read_settings(file)
        elif path:
            config = with_settings(config, file, path, ignored=RECORDED)
            refuse_inputs(file, path, embeddings="--embedding DIR", plans="--plans DIR")
        return cls(algo=algo, preset=preset, config=config)

    def __call__(self) -> None:
        """Train, draw the learning curve, and print the returns at the end."""
        from planspace.embed.saved_embedding import load_embedding
        from planspace.rl.training import train_policies
        from planspace.storage.compiled import use_compilation_cache

        if not self.task:
            raise UsageError(f"which task? {TASK_HELP}")
        task = find_training_task(load_or_name(self.task))
        if self.out is None:
            raise UsageError("`--out DIR` is required: the folder of the run.")
        self._print_rounding(task)
        if isinstance(task, GymTask):
            print(f"{task.name}: {GYM_HELP}", file=sys.stderr)
        embeddings = [load_embedding(folder) for folder in self.embedding]
        use_compilation_cache()
        trained = train_policies(
            task,
            self.config,
            embedding=embeddings,
            plans=self.plans,
            out=self.out,
            track=self.track,
            env_workers=self.env_workers,
        )
        self._draw_curve(trained, self.out)
        if diverged := [str(row.seed) for row in trained.returns if row.diverged]:
            raise PartialResult(
                f"seed {', '.join(diverged)} diverged and was frozen with the policy that it had. The other "
                "seeds went on, and everything is saved."
            )

    def _print_rounding(self, task: AnyTask) -> None:
        from planspace.rl.training import num_episodes

        rounded = self.config.iterations * num_episodes(task, self.config.batch_steps) * task.horizon
        if rounded != self.config.steps:
            steps = self.config.steps
            way = "up" if rounded > steps else "down"
            print(f"--steps {steps} is rounded {way} to {rounded}, for whole iterations", file=sys.stderr)

    def _draw_curve(self, trained: "TrainedPolicies", out: Path) -> None:
        from planspace.figures.learning_curves import plot_curves
        from planspace.figures.style import save_figure
        from planspace.rl.learning_curve import learning_curve

        history = trained.history
        rows = {"return, last iteration": history["return"], "return, evaluation": history["eval_return"]}
        if "eval_success" in history:
            rows["% at the goal, evaluation"] = 100 * history["eval_success"]
        for name, numbers in rows.items():
            last = numbers[-1]
            print(f"{name:<27}mean {last.mean():8.1f}   worst {last.min():8.1f}   best {last.max():8.1f}")
        print(save_figure(plot_curves({out.name: learning_curve(history)}, trained.task), out, "curve"))
