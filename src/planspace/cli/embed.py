"""`planspace embed`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.cli.tables import print_columns
from planspace.embed.config import PresetName
from planspace.embed.embedding import InputType
from planspace.embed.objectives.direct import Metric
from planspace.errors import UsageError
from planspace.seams import is_object_path, load_object

PRESETS_OWN = "(default: the preset's)"


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
    objective: str = "variational"
    """variational and direct are the paper's; vae, e2c, straightening, distance, pca, random and shuffled are
    what it is compared with. module.py:NAME is one of your own: a function or an object."""
    metric: Metric | None = None
    """The distance between states, for the direct objective."""
    linearity: Annotated[float | None, arg(metavar="WEIGHT", help_behavior_hint=PRESETS_OWN)] = None
    """lambda: how much straightness counts."""
    prior: Annotated[float | None, arg(metavar="WEIGHT", help_behavior_hint=PRESETS_OWN)] = None
    """How much z is pulled to a unit Gaussian; high values lose dimensions."""
    spacings: Annotated[tuple[int, ...] | None, arg(metavar="N ...", help_behavior_hint=PRESETS_OWN)] = None
    """Steps between the members of a triplet; 0 for any three states of a demonstration."""
    short_fraction: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint=PRESETS_OWN)] = None
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
        from planspace.demos.load import load_demos
        from planspace.embed.config import PRESETS
        from planspace.embed.fit import fit_embedding
        from planspace.embed.training import use_device
        from planspace.storage.compiled import use_compilation_cache

        if min(self.z_dim, self.seeds) < 1 or self.seed < 0:
            raise UsageError("--z-dim and --seeds must be at least 1, --seed at least 0.")
        if self.device:
            use_device(self.device)
        use_compilation_cache()
        own = is_object_path(self.objective)
        config = PRESETS[self.preset].with_objective(load_object(self.objective) if own else self.objective)
        changes = {
            "metric": self.metric,
            "linearity": self.linearity,
            "prior": self.prior,
            "spacings": () if self.spacings == (0,) else self.spacings,
            "short_fraction": self.short_fraction,
            "whitening": self.whitening,
            "inputs": self.inputs,
            "steps": self.steps,
            "batch": self.batch,
            "learning_rate": self.learning_rate,
        }
        changes = {name: value for name, value in changes.items() if value is not None}
        config = config.with_settings(z_dim=self.z_dim, columns=self.columns, **changes)
        embedding = fit_embedding(
            load_demos(self.demos),
            config=config,
            out=self.out,
            num_seeds=self.seeds,
            seed=self.seed,
            tensorboard=self.tensorboard,
        )
        about = embedding.about
        seeds = ", ".join(map(str, about["settings"]["seeds"]))
        print(f"seed {about['seed']} saved in {self.out}, the best of {seeds}")
        print_columns("test split", {"z": about["metrics"]["test"], "raw state": about["metrics_raw_state"]})
