"""`planspace train`."""

import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from planspace.errors import PartialResult, UsageError
from planspace.rl.algorithms.on_policy import CriticName
from planspace.rl.config import ShapingType, ZMode, ZTarget
from planspace.storage.tracking import TrackerName
from planspace.tasks.observation_types import ObservationType, RewardType

PRESETS_OWN = "(default: the preset's)"


@dataclass(frozen=True)
class Train:
    """Train policies on a task: all seeds at once, in one program."""

    out: Annotated[Path, arg(metavar="DIR")]
    """The run's folder. The same command continues an interrupted run."""
    task: Positional[Annotated[str, arg(metavar="TASK")]] = ""
    """A task's name; without it the names are listed."""
    algo: Literal["trpo", "ppo"] = "trpo"
    """The algorithm."""
    preset: Literal["paper", "modern"] = "paper"
    """paper: what the paper and the runs of 2020 did. modern: observations standardised as they come, what
    lies beyond the time limit counted; PPO by minibatches of steps."""
    obs: ObservationType = "raw"
    """raw: the state as it is. wrapped: angles on a circle within (-pi, pi]. trig: raw with sin and cos of
    its angles beside it."""
    z: ZMode = "none"
    """augment: the observation and z. replace: z alone."""
    z_to: ZTarget = "both"
    """Who sees z."""
    reward: RewardType = "dense"
    """sparse: 1 at the goal, 0 elsewhere. 2020: the swing-up's as the code of 2020 had it."""
    shaping: ShapingType = "none"
    """Reward coming nearer to the goal, too: by the distance in z, or between raw states. The returns that
    are reported are the task's own."""
    shaping_scale: Annotated[float, arg(metavar="X")] = 10.0
    """What the way from a mean start to the goal is worth in return."""
    embedding: Annotated[tuple[Path, ...], arg(metavar="DIR ...", help_behavior_hint="(default: none)")] = ()
    """What makes z; needed where there is z. Several are taken in turn: seed s takes number s modulo how many
    there are, so that the spread over seeds is that over embeddings as well."""
    seeds: Annotated[int, arg(metavar="N")] = 5
    """How many seeds."""
    steps: Annotated[int, arg(metavar="N")] = 960_000
    """Environment steps for each seed; rounded up to whole iterations of 4000 steps (of the whole episodes
    that come nearest to that)."""
    seed: int = 0
    """The first seed; the others follow it."""
    critic: Annotated[CriticName | None, arg(metavar="{linear,mlp}", help_behavior_hint=PRESETS_OWN)] = None
    """linear: ridge regression on simple features. mlp: two layers of 32 units."""
    hidden: Annotated[tuple[int, ...] | None, arg(metavar="N ...", help_behavior_hint=PRESETS_OWN)] = None
    """Units of the policy's hidden layers: a wider policy is a control for what z adds."""
    match_z: Annotated[int, arg(metavar="N")] = 0
    """Make policy and mlp critic so wide that they have as many parameters as with z of N numbers."""
    layer_norm: bool = False
    """Normalise the policy's hidden layers: another control."""
    eval_every: Annotated[int, arg(metavar="N")] = 25
    """Iterations (of 4000 steps) between evaluations by deterministic episodes; 0: at the end alone."""
    track: UseAppendAction[Annotated[tuple[TrackerName, ...], arg(metavar="{tensorboard,wandb}")]] = ()
    """Show the curves there, too (extra `track`): TensorBoard in DIR/tensorboard; Weights & Biases, offline
    in DIR/wandb where nobody is logged in. history.safetensors and log.jsonl have them always."""

    def __call__(self) -> None:
        """Trains and prints the returns at the end."""
        from planspace.embed.embedding import load_embedding
        from planspace.figures.learning_curves import plot_curves
        from planspace.figures.style import save_figure
        from planspace.rl.algorithms import find_algorithm
        from planspace.rl.config import TrainConfig, with_settings
        from planspace.rl.history import frozen_seeds
        from planspace.rl.learning_curve import learning_curve
        from planspace.rl.training import num_episodes, train_policies
        from planspace.storage.compiled import use_compilation_cache
        from planspace.tasks.catalog import TASKS, find_task

        if not self.task:
            raise UsageError(f"which task? There are {', '.join(sorted(TASKS))}.")
        given = {f.name: getattr(self, f.name) for f in fields(TrainConfig) if hasattr(self, f.name)}
        chosen = {
            "critic": self.critic,
            "hidden": self.hidden,
            "match_z": self.match_z or None,
            "layer_norm": self.layer_norm or None,
        }
        changes = {name: value for name, value in chosen.items() if value is not None}
        algorithm = with_settings(find_algorithm(self.algo, self.preset), **changes)
        config = TrainConfig(algorithm, **given, num_seeds=self.seeds)
        task = find_task(self.task)
        rounded = config.iterations * num_episodes(task, config.batch_steps) * task.horizon
        if rounded != self.steps:
            print(f"--steps {self.steps} rounded to {rounded}, whole iterations", file=sys.stderr)
        embeddings = [load_embedding(folder) for folder in self.embedding]
        use_compilation_cache()
        history = train_policies(task, config, embedding=embeddings, out=self.out, track=self.track).history
        for name, returns in (("last iteration", history["return"]), ("evaluation", history["eval_return"])):
            last = returns[-1]
            spread = f"worst {last.min():8.1f}   best {last.max():8.1f}"
            print(f"return, {name:<16}mean {last.mean():8.1f}   {spread}")
        print(
            save_figure(plot_curves({self.out.name: learning_curve(history)}, self.task), self.out, "curve")
        )
        if frozen := frozen_seeds(history, config.seeds):
            raise PartialResult(
                f"{frozen}: numbers that are not finite. Each was frozen with the policy it had; the others "
                "went on, and everything is saved."
            )
