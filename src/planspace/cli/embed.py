"""`planspace embed`."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.cli.config_files import (
    ConfigFile,
    check_least,
    given_config,
    given_name,
    given_option,
    group_in_file,
    load_or_name,
    named_in_file,
    with_settings,
)
from planspace.cli.tables import print_columns
from planspace.embed.config import PRESETS, FitConfig, TimeHeadConfig, update_saved
from planspace.embed.objectives import OBJECTIVES
from planspace.errors import UsageError, unknown

OBJECTIVE_HELP = (
    f"One of {', '.join(OBJECTIVES)}; or module.py:NAME for your own. variational and direct are the "
    "paper's. The weights of the objective are options, too."
)


@dataclass(frozen=True)
class Embed:
    """Train an embedding on demonstrations.

    Several seeds are trained at once, and the best one is saved.
    """

    demos: Positional[Annotated[Path | None, arg(metavar="DEMOS", help_behavior_hint="(required)")]] = None
    """A dataset folder; the name of ready-made plans; or minari:ID, recorded from a planspace task."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(required)")] = None
    """The embedding's folder. The same command continues an interrupted training."""
    objective: Annotated[str, arg(metavar="NAME|module.py:NAME", help=OBJECTIVE_HELP)] = "variational"
    seeds: Annotated[int, arg(metavar="N")] = 5
    """Number of seeds to train."""
    seed: int = 0
    """The first seed, and the seed of the split into training, validation and test."""
    tensorboard: bool = False
    """Also write the curves for TensorBoard in DIR/tensorboard (extra `track`). log.jsonl always has them."""
    time_head: bool = False
    """Also train `time_to_go`, the shortest time between two states in seconds, after the rest. Datasets of
    `planspace plan --keep-trees` make it better."""
    device: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: JAX's)")] = ""
    """The JAX device to compute on: cpu, cuda or tpu. Networks of this size are fastest on a CPU."""
    config_file: ConfigFile = None
    config: FitConfig = field(default_factory=FitConfig)
    time: TimeHeadConfig = field(default_factory=TimeHeadConfig)

    @classmethod
    def default(cls, arguments: Sequence[str]) -> "Embed":
        """The defaults that --preset, --objective and --config ask for."""
        path, file = given_config(arguments)
        if "fit" in file:  # the config.json of an embedding
            file = update_saved(group_in_file(file, "fit", path))
        head = group_in_file(file, "time_head", path) if "time_head" in file else None
        file = {name: value for name, value in file.items() if name != "time_head"}
        preset = given_name(arguments, file, "preset", path) or "modern"
        if preset not in PRESETS:
            raise unknown("preset", preset, PRESETS)
        objective = (
            given_option(arguments, "--objective") or named_in_file(file, "objective", path) or "variational"
        )
        config = PRESETS[preset].with_objective(load_or_name(objective))
        if path:
            config = with_settings(config, file, path)
        time = TimeHeadConfig() if head is None else with_settings(TimeHeadConfig(), head, path)
        return cls(objective=objective, config=config, time=time, time_head=head is not None)

    def __call__(self) -> None:
        """Train, and print the geometry on the test split."""
        from planspace.demos.load import load_demos
        from planspace.embed.fit import fit_embedding
        from planspace.embed.training import use_device
        from planspace.storage.compiled import use_compilation_cache

        if self.demos is None:
            raise UsageError("which demonstrations? Give a dataset folder, which `planspace plan` makes.")
        if self.out is None:
            raise UsageError("`--out DIR` is required: the folder of the embedding.")
        check_least(self, seeds=1, seed=0)
        if self.device:
            use_device(self.device)
        use_compilation_cache()
        embedding = fit_embedding(
            load_demos(self.demos),
            config=self.config,
            out=self.out,
            num_seeds=self.seeds,
            seed=self.seed,
            time_head=self.time if self.time_head else False,
            tensorboard=self.tensorboard,
        )
        about = embedding.require_about()
        seeds = about.settings.seeds
        best = f", the best of {', '.join(map(str, seeds))}" if len(seeds) > 1 else ""
        print(f"seed {about.seed} saved in {self.out}{best}")
        print_columns("test split", {"z": about.metrics["test"], "raw state": about.metrics_raw_state})
