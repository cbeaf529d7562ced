"""`planspace pixels`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.cli.config_files import check_least
from planspace.cli.tables import print_values
from planspace.embed.pixels.config import ImageFitConfig
from planspace.errors import UsageError


@dataclass(frozen=True)
class Pixels:
    """Train an encoder that reads z from pictures.

    A small convolutional network learns to compute, from the last few pictures, what an embedding computes
    from the state. The training knows the states of its pictures; the encoder does not need them.
    """

    demos: Positional[Annotated[Path | None, arg(metavar="DEMOS", help_behavior_hint="(required)")]] = None
    """A dataset folder with a model, or the name of ready-made plans."""
    teacher: Annotated[Path | None, arg(metavar="EMBEDDING", help_behavior_hint="(required)")] = None
    """The embedding of states to learn from: a folder, or the name of a ready-made one."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(required)")] = None
    """The encoder's folder. The same command continues an interrupted training."""
    visited: Annotated[tuple[Path, ...], arg(metavar="DEMOS", help_behavior_hint="(default: none)")] = ()
    """Datasets of states that were visited, such as CONTROL/episodes of a `planspace control` (DAgger:
    control, add the episodes, train again). Plans, trees and each of these give equally many states."""
    seed: int = 0
    """Seed of pictures, weights and batches."""
    config: ImageFitConfig = field(default_factory=ImageFitConfig)

    def __call__(self) -> None:
        """Train, and print how well held-out plans are encoded."""
        from planspace.demos.load import load_demos
        from planspace.embed.pixels.fit import fit_image_encoder
        from planspace.embed.saved_embedding import load_embedding
        from planspace.storage.compiled import use_compilation_cache

        if self.demos is None:
            raise UsageError("which demonstrations? Give a dataset folder, which `planspace plan` makes.")
        if self.teacher is None:
            raise UsageError("`--teacher EMBEDDING` is required: the embedding that `planspace embed` made.")
        if self.out is None:
            raise UsageError("`--out DIR` is required: the folder of the encoder.")
        check_least(self, seed=0)
        use_compilation_cache()
        encoder = fit_image_encoder(
            load_demos(self.demos),
            load_embedding(self.teacher),
            config=self.config,
            visited=[load_demos(path) for path in self.visited],
            out=self.out,
            seed=self.seed,
        )
        print(f"encoder of pictures saved in {self.out}; on held-out plans:")
        print_values(encoder.about["metrics"])
