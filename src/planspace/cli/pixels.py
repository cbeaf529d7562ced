"""`planspace pixels`."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from planspace.cli.config_files import check_least, given_option, load_or_name
from planspace.cli.tables import print_values
from planspace.embed.config import find_objective
from planspace.embed.pixels.config import ImageFitConfig, PictureSpaceConfig
from planspace.errors import UsageError

OBJECTIVE_HELP = (
    "With --target pictures: variational, vae, straightening, distance, e2c or shuffled; or module.py:NAME "
    "for your own. The weights of the objective are options, too."
)


@dataclass(frozen=True)
class Pixels:
    """Train an encoder that reads z from pictures.

    A small convolutional network learns to compute, from the last few pictures, what an embedding computes
    from the state. The training knows the states of its pictures; the encoder does not need them. With
    `--target pictures`, there is no such embedding: the network learns a z of its own from pictures of plans.
    """

    demos: Positional[Annotated[Path | None, arg(metavar="DEMOS", help_behavior_hint="(required)")]] = None
    """A dataset folder with a model, or the name of ready-made plans."""
    teacher: Annotated[
        Path | None, arg(metavar="EMBEDDING", help_behavior_hint="(required, except for --target pictures)")
    ] = None
    """The embedding of states to learn from: a folder, or the name of a ready-made one."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(required)")] = None
    """The encoder's folder. The same command continues an interrupted training."""
    visited: Annotated[tuple[Path, ...], arg(metavar="DEMOS", help_behavior_hint="(default: none)")] = ()
    """Datasets of states that were visited, such as CONTROL/episodes of a `planspace control` (DAgger:
    control, add the episodes, train again). Plans, trees and each of these give equally many states."""
    seed: int = 0
    """Seed of pictures, weights and batches."""
    objective: Annotated[str, arg(metavar="NAME|module.py:NAME", help=OBJECTIVE_HELP)] = "variational"
    config: ImageFitConfig = field(default_factory=ImageFitConfig)

    @classmethod
    def default(cls, arguments: Sequence[str]) -> "Pixels":
        """The defaults that --objective asks for."""
        config = ImageFitConfig()
        if named := given_option(arguments, "--objective"):
            chosen: Any = given_option(arguments, "--target") or config.target
            objective = find_objective(load_or_name(named), config.space.objective)
            config = replace(config, target=chosen, space=PictureSpaceConfig(objective))
        return cls(objective=named or cls.objective, config=config)

    def __call__(self) -> None:
        """Train, and print how well held-out plans are encoded."""
        from planspace.demos.load import load_demos
        from planspace.embed.pixels.fit import fit_image_encoder
        from planspace.embed.saved_embedding import load_embedding
        from planspace.storage.compiled import use_compilation_cache

        if self.demos is None:
            raise UsageError("which demonstrations? Give a dataset folder, which `planspace plan` makes.")
        if self.teacher is None and self.config.target != "pictures":
            raise UsageError(
                "`--teacher EMBEDDING` is required: the embedding that `planspace embed` made. Without one, "
                "--target pictures learns a z of its own."
            )
        if self.out is None:
            raise UsageError("`--out DIR` is required: the folder of the encoder.")
        check_least(self, seed=0)
        use_compilation_cache()
        encoder = fit_image_encoder(
            load_demos(self.demos),
            None if self.teacher is None else load_embedding(self.teacher),
            config=self.config,
            visited=[load_demos(path) for path in self.visited],
            out=self.out,
            seed=self.seed,
        )
        print(f"encoder of pictures saved in {self.out}; on held-out plans:")
        print_values(encoder.about["metrics"])
