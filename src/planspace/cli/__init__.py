"""The command line: each verb is a dataclass whose fields are its options, and a call to one function.

Modules are imported where a verb needs them, so that `--help` answers at once.
"""

import contextlib
import io
import json
import sys
import traceback
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional, UseAppendAction, arg, subcommand

from planspace.embed.config import Metric, ObjectiveName, PresetName
from planspace.embed.embedding import InputType
from planspace.errors import PartialResult, PlanspaceError, UsageError, printable, unknown
from planspace.rl.config import Algo, CriticName, RLPreset, ShapingType, ZMode, ZTarget
from planspace.storage.tracking import TrackerName
from planspace.tasks.observation_types import ObservationType, RewardType

EXIT_FAILURE, EXIT_INTERRUPTED = 1, 130
PRESETS_OWN = "(default: the preset's)"


@dataclass(frozen=True)
class Run:
    """Go from nothing to a first result: plan, embed, train, report."""

    task: Positional[Annotated[str, arg(metavar="TASK")]] = "cartpole-swingup"
    """cartpole, cartpole-swingup, reacher-trig or reacher-raw."""
    budget: Literal["smoke", "small", "full"] = "small"
    """smoke: half a minute, to see that it works. small: five minutes, a first result. full: 300
    demonstrations, and 15 policies of 2 M steps an arm."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: runs/TASK-BUDGET)")] = None
    """The run's folder. The same command continues an interrupted run."""
    seed: int = 0
    """Seed of every stage; policies take this and the following ones."""

    def __call__(self) -> None:
        """Runs it and prints the closing table."""
        from planspace.storage.compiled import keep_compiled
        from planspace.study.quickstart import closing_table, run

        keep_compiled()
        out = self.out or Path("runs") / f"{self.task}-{self.budget}"
        summary = run(self.task, self.budget, out, self.seed)
        print(closing_table(summary))
        print(f"\nreport           {out / 'report.html'}")
        if summary["diverged"]:
            raise PartialResult(f"numbers that are not finite: {'; '.join(summary['diverged'])}.")


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
        from planspace.plan.generate import generate
        from planspace.plan.planner import PlannerConfig
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
        config = PlannerConfig.for_problem(problem, **changes)
        folder = generate(
            problem, self.out, num=self.num, seed=self.seed, config=config, workers=self.workers or None
        )
        print(f"{folder.num_episodes} demonstrations in {self.out}")


@dataclass(frozen=True)
class DemosShow:
    """Say what a dataset holds."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder."""
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Prints it."""
        from planspace.demos.describe import describe

        _print(describe(self.folder), self.json)


@dataclass(frozen=True)
class DemosValidate:
    """Check every shard's hash, and that the recorded controls lead to the recorded states."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder."""
    replay: bool = False
    """Roll the controls out in plain MuJoCo and compare."""
    untrusted: bool = False
    """Its model comes from strangers: try it first in a process of its own, in bounded memory and time."""
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Prints what was checked."""
        from planspace.demos.describe import validate

        found = validate(self.folder, replay_controls=self.replay, untrusted=self.untrusted)
        _print(found, self.json)


@dataclass(frozen=True)
class DemosPlot:
    """Draw a dataset in state space."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Where demos.png and demos.svg go."""

    def __call__(self) -> None:
        """Draws it."""
        from planspace.demos.folder import load_demos
        from planspace.figures.demos import plot_demos
        from planspace.figures.style import save_figure
        from planspace.storage.files import make_folder

        print(save_figure(plot_demos(load_demos(self.folder)), make_folder(self.out), "demos"))


@dataclass(frozen=True)
class DemosRender:
    """Film the robot in its recorded states, in real time."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder that holds the model."""
    out: Annotated[Path, arg(metavar="FILE.gif|FILE.mp4")]
    """The film; an MP4 needs the extra `video`."""
    episodes: Annotated[int, arg(metavar="N")] = 3
    """How many demonstrations, from the first on, one after another."""
    fps: Annotated[int, arg(metavar="N")] = 30
    """Pictures a second."""
    width: Annotated[int, arg(metavar="PIXELS")] = 480
    """Width of the picture."""
    height: Annotated[int, arg(metavar="PIXELS")] = 360
    """Height of the picture."""
    camera: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: the model's first)")] = ""
    """A camera of the model; one that shows all of it where the model has none."""
    untrusted: bool = False
    """Its model comes from strangers: try it first in a process of its own, in bounded memory and time."""

    def __call__(self) -> None:
        """Films it."""
        from planspace.demos.folder import load_demos
        from planspace.demos.render import FilmConfig, render_demos
        from planspace.mjcf.subprocess_model import compile_apart

        config = FilmConfig(self.episodes, self.fps, self.width, self.height, self.camera)
        demos = load_demos(self.folder)
        if self.untrusted:
            compile_apart(demos.info.mjcf)
        render_demos(demos, self.out, config)
        print(self.out)


@dataclass(frozen=True)
class DemosImport:
    """Make a dataset of demonstrations in another format: NPZ, CSV, Minari, or the plans of 2020."""

    source: Positional[Annotated[tuple[str, ...], arg(metavar="SOURCE", help_behavior_hint="(required)")]]
    """FILE.npz with `states`, `controls`, `time`, `offsets`; FILE.csv, one demonstration a file or a column
    `episode`; minari:ID; 2020's .json or .out plans. Several files, or a folder of them, make one dataset."""
    out: Annotated[Path, arg(metavar="DIR")]
    """The dataset folder to make."""
    problem: Annotated[str, arg(metavar="PROBLEM|FILE.yaml", help_behavior_hint="(default: none)")] = ""
    """The planning problem the states belong to: gives names, units, angles and the model."""
    state: UseAppendAction[
        Annotated[tuple[str, ...], arg(metavar="NAME=COLUMN", help_behavior_hint="(repeatable)")]
    ] = ()
    """Which column is a state; NAME=INDEX or NAME=KEY[INDEX] in Minari. By default columns go by name."""
    control: UseAppendAction[
        Annotated[tuple[str, ...], arg(metavar="NAME=COLUMN", help_behavior_hint="(repeatable)")]
    ] = ()
    """Which column is a control. By default control1 .., control0 .., or the actuators' names."""
    dt: Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint="(default: none)")] = None
    """The time step, for a source that does not say."""
    as_recorded: bool = False
    """Keep uneven time steps and wound-up angles. Otherwise all demonstrations are brought to one step, and
    angles to end in (-pi, pi]."""
    untrusted: bool = False
    """The problem comes from strangers: its model is read in a process of its own, in bounded memory and
    time."""

    def __call__(self) -> None:
        """Imports it."""
        from planspace.demos.convert import import_demos
        from planspace.demos.recording import ImportOptions, assignments
        from planspace.plan.generate import state_info
        from planspace.tasks.problem_file import load_problem

        states, controls = assignments("--state", self.state), assignments("--control", self.control)
        options = ImportOptions(states, controls, self.dt, self.as_recorded)
        problem = load_problem(self.problem, untrusted=self.untrusted) if self.problem else None
        folder = import_demos(self.source, self.out, state_info(problem) if problem else None, options)
        print(f"{folder.num_episodes} demonstrations in {self.out}")


@dataclass(frozen=True)
class DemosExport:
    """Write a dataset in a format that `demos import` reads back."""

    folder: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder."""
    target: Positional[Annotated[str, arg(metavar="FILE.npz|FILE.csv|minari:ID")]]
    """What to write; a Minari dataset is kept where Minari keeps its own."""

    def __call__(self) -> None:
        """Exports it."""
        from planspace.demos.convert import export_demos
        from planspace.demos.folder import load_demos

        print(export_demos(load_demos(self.folder), self.target))


@dataclass(frozen=True)
class Demos:
    """Look at, check, draw, film, import and export demonstrations."""

    action: (
        Annotated[DemosShow, subcommand("show")]
        | Annotated[DemosValidate, subcommand("validate")]
        | Annotated[DemosPlot, subcommand("plot")]
        | Annotated[DemosRender, subcommand("render")]
        | Annotated[DemosImport, subcommand("import")]
        | Annotated[DemosExport, subcommand("export")]
    )

    def __call__(self) -> None:
        """Hands on to the action."""
        self.action()


@dataclass(frozen=True)
class Embed:
    """Train an embedding on demonstrations: several seeds at once, the best one saved."""

    demos: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder; or minari:ID, recorded from a task of planspace."""
    out: Annotated[Path, arg(metavar="DIR")]
    """The embedding's folder. The same command continues an interrupted one."""
    preset: PresetName = "modern"
    """modern: what measured best. paper: what the paper's text says. Options below change parts of it."""
    z_dim: Annotated[int, arg(metavar="N")] = 3
    """Numbers in z."""
    seeds: Annotated[int, arg(metavar="N")] = 5
    """How many seeds to train."""
    seed: int = 0
    """The first of them, and the seed of the split in training, validation and test."""
    columns: Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(default: all)")] = ()
    """The states the embedding reads, by name."""
    objective: ObjectiveName = "variational"
    """variational and direct are the paper's; vae, e2c, straightening, distance, pca, random and shuffled are
    what it is compared with."""
    metric: Metric = "l2"
    """The distance between states, for the direct objective."""
    linearity: Annotated[float | None, arg(metavar="WEIGHT", help_behavior_hint=PRESETS_OWN)] = None
    """lambda: how much straightness counts."""
    prior: Annotated[float | None, arg(metavar="WEIGHT", help_behavior_hint=PRESETS_OWN)] = None
    """How much z is pulled to a unit Gaussian; high values lose dimensions."""
    spacings: Annotated[tuple[int, ...] | None, arg(metavar="N ...", help_behavior_hint=PRESETS_OWN)] = None
    """Steps between the members of a triplet; 0 for any three states of a demonstration."""
    near: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint=PRESETS_OWN)] = None
    """With --spacings 0, how many of those are mostly close together: fewer makes whole plans straighter,
    more makes z of more use to a policy."""
    whitening: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint=PRESETS_OWN)] = None
    """How far z's directions are brought to the same size: 0 not at all, 1 all the way."""
    inputs: Annotated[
        InputType | None, arg(metavar="{raw,standard,trig}", help_behavior_hint=PRESETS_OWN)
    ] = None
    """raw: numbers as they are. standard: standardised, for plans of which windings are a part. trig: sin and
    cos of circular angles, then standardised."""
    steps: Annotated[int | None, arg(metavar="N", help_behavior_hint=PRESETS_OWN)] = None
    """Optimiser steps."""
    batch: Annotated[int | None, arg(metavar="N", help_behavior_hint=PRESETS_OWN)] = None
    """Triplets a step."""
    learning_rate: Annotated[float | None, arg(metavar="RATE", help_behavior_hint=PRESETS_OWN)] = None
    """Adam's rate."""
    tensorboard: bool = False
    """Write the curves for TensorBoard in DIR/tensorboard, too (extra `track`); log.jsonl has them always."""
    device: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: JAX's)")] = ""
    """The JAX device to compute on: cpu, cuda, tpu. Networks this small are at home on a CPU."""

    def __call__(self) -> None:
        """Trains it and prints its geometry on the test split."""
        from planspace.demos.folder import load_demos
        from planspace.embed.config import PRESETS
        from planspace.embed.fit import fit
        from planspace.embed.training import use_device
        from planspace.storage.compiled import keep_compiled

        if min(self.z_dim, self.seeds) < 1 or self.seed < 0:
            raise UsageError("--z-dim and --seeds must be at least 1, --seed at least 0.")
        if self.device:
            use_device(self.device)
        keep_compiled()
        config = PRESETS[self.preset].changed(
            z_dim=self.z_dim,
            columns=self.columns,
            name=self.objective,
            metric=self.metric,
            linearity=self.linearity,
            prior=self.prior,
            spacings=() if self.spacings == (0,) else self.spacings,
            near=self.near,
            whitening=self.whitening,
            inputs=self.inputs,
            steps=self.steps,
            batch=self.batch,
            learning_rate=self.learning_rate,
        )
        embedding = fit(
            load_demos(self.demos),
            self.out,
            config=config,
            num_seeds=self.seeds,
            seed=self.seed,
            tensorboard=self.tensorboard,
        )
        about = embedding.about
        seeds = ", ".join(map(str, about["settings"]["seeds"]))
        print(f"seed {about['seed']} saved in {self.out}, the best of {seeds}")
        _print_beside("test split", {"z": about["metrics"]["test"], "raw state": about["metrics_raw_state"]})


@dataclass(frozen=True)
class Measure:
    """Measure an embedding's geometry on demonstrations, beside the raw state's and a constant's.

    On the demonstrations it was trained on, each split is measured by itself. Straightness can be won by
    throwing state away: look at effective_rank and decoded_error, too.
    """

    embedding: Positional[Annotated[Path, arg(metavar="EMBEDDING")]]
    """An embedding's folder."""
    demos: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder; any whose states have the names the embedding reads."""
    truth: Annotated[Path | None, arg(metavar="FILE.npz", help_behavior_hint="(default: none)")] = None
    """The least times to the goal, if they are known, to correlate distances with: `states` [n, state],
    `time` [n] in seconds, `goal` [state]."""
    plot: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """Draw paths in z, distance against time, and the curves of the training into DIR. Of the demonstrations
    it was trained on, the test split is drawn."""
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Prints the metrics."""
        from planspace.demos.folder import load_demos
        from planspace.embed.embedding import load_embedding
        from planspace.embed.measurement import assess
        from planspace.storage.files import make_folder

        demos, embedding = load_demos(self.demos), load_embedding(self.embedding)
        if self.plot is not None:
            make_folder(self.plot)
        found = assess(embedding, demos, self.truth)
        if self.plot is not None:
            from planspace.figures.embedding_figures import draw_embedding

            draw_embedding(embedding, self.embedding, demos, self.plot)
            found["figures"] = str(self.plot)
        if self.json:
            print(json.dumps(found, indent=2))
            return
        for split, columns in found.pop("splits").items():
            intervals = {k: f"[{low:.3g}, {high:.3g}]" for k, (low, high) in columns["intervals"].items()}
            shown = {"z": columns["embedding"], "95 % interval": intervals}
            _print_beside(split, shown | {"raw state": columns["raw_state"], "constant": columns["constant"]})
            print()
        _print(found, False)


@dataclass(frozen=True)
class Export:
    """Write an embedding's encoder for programs that have no Python; needs the extra `onnx`."""

    embedding: Positional[Annotated[Path, arg(metavar="EMBEDDING")]]
    """An embedding's folder."""
    out: Positional[Annotated[Path, arg(metavar="FILE")]]
    """The file to make."""
    to: Literal["onnx"] = "onnx"
    """onnx: `state` [batch, n] to `mu` and `sigma` [batch, z] of q(z|x), all float32."""

    def __call__(self) -> None:
        """Exports it."""
        from planspace.embed.embedding import load_embedding
        from planspace.embed.export import export_onnx

        export_onnx(load_embedding(self.embedding), self.out)
        print(self.out)


@dataclass(frozen=True)
class Train:
    """Train policies on a task: all seeds at once, in one program."""

    out: Annotated[Path, arg(metavar="DIR")]
    """The run's folder. The same command continues an interrupted run."""
    task: Positional[Annotated[str, arg(metavar="TASK")]] = ""
    """A task's name; without it the names are listed."""
    algo: Algo = "trpo"
    """The algorithm."""
    preset: RLPreset = "paper"
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
        from planspace.figures.learning_curves import learning_curve, plot_curves
        from planspace.figures.style import save_figure
        from planspace.rl.config import TrainConfig
        from planspace.rl.history import frozen_seeds
        from planspace.rl.train import num_episodes, train
        from planspace.storage.compiled import keep_compiled
        from planspace.tasks.task import TASKS, find_task

        if not self.task:
            raise UsageError(f"which task? There are {', '.join(sorted(TASKS))}.")
        given = {f.name: getattr(self, f.name) for f in fields(TrainConfig) if hasattr(self, f.name)}
        config = TrainConfig(**given, num_seeds=self.seeds)
        chosen = {
            "critic": self.critic,
            "hidden": self.hidden,
            "match_z": self.match_z or None,
            "layer_norm": self.layer_norm or None,
        }
        if changes := {name: value for name, value in chosen.items() if value is not None}:
            config = config.learning(**changes)
        task = find_task(self.task)
        rounded = config.iterations * num_episodes(task) * task.horizon
        if rounded != self.steps:
            print(f"--steps {self.steps} rounded to {rounded}, whole iterations", file=sys.stderr)
        embeddings = [load_embedding(folder) for folder in self.embedding]
        keep_compiled()
        history = train(config, self.out, embeddings, self.track)
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


@dataclass(frozen=True)
class Curves:
    """Draw the learning curves of runs into one figure, as the paper does."""

    out: Annotated[Path, arg(metavar="DIR")]
    """Where curves.png and curves.svg go."""
    runs: Positional[Annotated[tuple[Path, ...], arg(metavar="RUN ...")]] = ()
    """Folders of `planspace train`. Line: mean over seeds of returns smoothed over 10 iterations. Band:
    second worst to second best seed. Dashed: the run with the highest smoothed return at any point."""
    title: str = ""
    """Above the figure."""

    def __call__(self) -> None:
        """Draws them."""
        from planspace.figures.learning_curves import learning_curve, plot_curves
        from planspace.figures.style import save_figure
        from planspace.rl.history import load_history
        from planspace.storage.files import make_folder

        if not self.runs:
            raise UsageError("which runs? Give folders that `planspace train` made.")
        curves = {str(run): learning_curve(load_history(run)) for run in self.runs}
        print(save_figure(plot_curves(curves, self.title), make_folder(self.out), "curves"))


@dataclass(frozen=True)
class Play:
    """Watch a trained policy: deterministic episodes, their returns, and a film if asked for."""

    run: Positional[Annotated[Path, arg(metavar="RUN")]]
    """The folder of a `planspace train`."""
    seed: Annotated[str, arg(metavar="best|N")] = "best"
    """Which of its seeds; best: the one that earned most in the last evaluation."""
    episodes: Annotated[int, arg(metavar="N")] = 10
    """How many episodes."""
    start_seed: int = 1000
    """The seed of the first episode's start; the others follow it."""
    video: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Film them: FILE.gif, or FILE.mp4 (extra `video`)."""

    def __call__(self) -> None:
        """Plays, prints the returns and writes the film."""
        from planspace.demos.render import FilmConfig, check_film, render_demos
        from planspace.rl.play import play
        from planspace.rl.saved_policy import load_policy

        if self.episodes < 1 or self.start_seed < 0:
            raise UsageError("--episodes must be at least 1, --start-seed at least 0.")
        if self.seed != "best" and not (self.seed.isascii() and self.seed.isdigit()):
            raise UsageError(f"--seed is best or a number, got {self.seed!r}.")
        if self.video is not None:
            check_film(self.video)
        policy = load_policy(self.run, "best" if self.seed == "best" else int(self.seed))
        returns, demos = play(policy, self.episodes, self.start_seed)
        print(f"seed {policy.seed}, {len(returns)} episodes of {policy.about['env_id']}")
        print(f"return: mean {returns.mean():.1f}, worst {returns.min():.1f}, best {returns.max():.1f}")
        if self.video is not None:
            render_demos(demos, self.video, FilmConfig())
            print(self.video)


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


@dataclass(frozen=True)
class Report:
    """Write the report of a `planspace run` anew; what the run had not finished is finished first."""

    folder: Positional[Annotated[Path, arg(metavar="DIR")]]
    """The run's folder."""
    json: bool = False
    """Print the summary as JSON."""

    def __call__(self) -> None:
        """Writes it and prints the closing table."""
        from planspace.study.quickstart import closing_table, rebuild

        summary = rebuild(self.folder)
        print(json.dumps(summary, indent=2) if self.json else closing_table(summary))


@dataclass(frozen=True)
class Repair:
    """Look for damaged files and set them aside, so that the command that made a folder can go on."""

    folder: Positional[Annotated[Path, arg(metavar="DIR")]]
    """A dataset, an embedding, a training, a run or studies. Nothing is removed: a damaged file stays there
    as damaged-1-NAME. Of a dataset, the shards before the first damaged one are kept."""

    def __call__(self) -> None:
        """Prints what was damaged."""
        from planspace.cli.repair import repair

        lines = repair(self.folder)
        print("\n".join(map(printable, lines)) or f"nothing in {self.folder} is damaged.")
        if lines:
            print(
                "Damaged files were set aside. The command that made them, run again, makes what is missing."
            )


@dataclass(frozen=True)
class Doctor:
    """Say what is installed, what is missing, and what to do about it."""

    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Prints the findings."""
        from planspace.cli.doctor import as_data, as_text, examine

        findings = examine()
        print(json.dumps(as_data(findings), indent=2) if self.json else as_text(findings))


Command = (
    Annotated[Run, subcommand("run")]
    | Annotated[Plan, subcommand("plan")]
    | Annotated[Demos, subcommand("demos")]
    | Annotated[Embed, subcommand("embed")]
    | Annotated[Measure, subcommand("measure")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Train, subcommand("train")]
    | Annotated[Curves, subcommand("curves")]
    | Annotated[Play, subcommand("play")]
    | Annotated[Study, subcommand("study")]
    | Annotated[Report, subcommand("report")]
    | Annotated[Repair, subcommand("repair")]
    | Annotated[Doctor, subcommand("doctor")]
)


def main(arguments: list[str] | None = None) -> int:
    """Runs one command.

    Args:
        arguments: what follows the program's name; by default the process's own.

    Returns:
        The exit code: 0 done, 1 failed, 2 wrong usage, 3 partly done, 130 interrupted.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if "--version" in arguments:
        import planspace

        print(planspace.__version__)
        return 0
    debug = "--debug" in arguments
    try:
        _parse([a for a in arguments if a != "--debug"])()
    except SystemExit as stop:
        return int(stop.code or 0)
    except KeyboardInterrupt:
        print("interrupted; the same command continues from here.", file=sys.stderr)
        return EXIT_INTERRUPTED
    except PlanspaceError as error:
        if debug:
            _print_traceback()
        print(f"planspace: {error}", file=sys.stderr)
        return error.exit_code
    except MemoryError:
        if debug:
            _print_traceback()
        print("planspace: there is not enough memory for that.", file=sys.stderr)
        return EXIT_FAILURE
    except Exception as error:
        if debug:
            _print_traceback()
        message = printable(" ".join(str(error).split()))
        print(
            f"planspace: unexpected {type(error).__name__}: {message} (--debug shows where)", file=sys.stderr
        )
        return EXIT_FAILURE
    return 0


def _parse(arguments: list[str]) -> Any:
    """The command, or one line on standard error and exit code 2."""
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                tyro.conf.OmitSubcommandPrefixes[tyro.conf.OmitArgPrefixes[Command]],
                args=arguments,
                prog="planspace",
                description="State embeddings in which demonstrated plans are straight lines. Beside each "
                "command's own options: --debug shows the traceback of an error, --version the version.",
            )
    except SystemExit as stop:
        if stop.code:
            print(f"planspace: {printable(_one_line(complaint.getvalue()))}", file=sys.stderr)
        raise


def _setting(text: str) -> tuple[str, float]:
    """`KEY=VALUE` taken apart."""
    key, _, value = text.partition("=")
    try:
        return key, float(value)
    except ValueError:
        raise UsageError(f"--settings takes KEY=VALUE with a number, got {text!r}.") from None


def _one_line(box: str) -> str:
    """Takes the text out of a drawn box, whose first line is its frame and title."""
    lines = [line.strip("│|").strip() for line in box.splitlines()[1:]]
    return " ".join(line for line in lines if line.strip("─-╰╯+"))


def _print_traceback() -> None:
    for line in traceback.format_exc().split("\n"):
        print(printable(line), file=sys.stderr)


def _print(value: dict[str, Any], as_json: bool, indent: str = "") -> None:
    if as_json:
        print(json.dumps(value, indent=2))
        return
    for key, item in value.items():
        if isinstance(item, dict):
            print(printable(f"{indent}{key}"))
            _print(item, False, indent + "  ")
        else:
            shown = f"{item:.4g}" if isinstance(item, float) else item
            print(printable(f"{indent}{key:<22}{shown}"))


def _print_beside(title: str, columns: dict[str, dict[str, Any]]) -> None:
    """A table with a row for each number of the first column."""
    print(f"{title:<20}" + "".join(f"{name:>18}" for name in columns))
    for row in next(iter(columns.values())):
        cells = [column.get(row, "") for column in columns.values()]
        shown = [f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in cells]
        print(printable(f"  {row:<18}" + "".join(f"{cell:>18}" for cell in shown)))
