"""`planspace repair`: which files of planspace's folders can be repaired."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.errors import PlanspaceError, printable
from planspace.storage.repair import Check, Damage, repair_folder, unreadable


@dataclass(frozen=True)
class Repair:
    """Find damaged files and set them aside, so that the command that made a folder can go on."""

    folder: Positional[Annotated[Path, arg(metavar="DIR")]]
    """Folder of a dataset, an embedding, an encoder of pictures, a training run, a `planspace run` or
    studies. Nothing is removed: a damaged file is renamed to damaged-1-NAME. A dataset keeps the shards
    before the first damaged one."""

    def __call__(self) -> None:
        """Print what was damaged."""
        lines = repair(self.folder)
        print("\n".join(map(printable, lines)) or f"No file in {self.folder} is damaged.")
        if lines:
            print("Damaged files were set aside. Run the command that made them again to restore them.")


def repair(folder: Path) -> list[str]:
    """Repair a folder of planspace and the folders in it.

    Args:
        folder: a dataset, an embedding, a training run, a `planspace run` or studies.

    Returns:
        One line for each damage that was found.

    Raises:
        PlanspaceError: the folder does not exist or cannot be written.
    """
    from planspace.embed.saved_embedding import LOG
    from planspace.study.execute import WHOLE

    return repair_folder(folder, _checks(), finished_marks=(WHOLE,), logs=(LOG,))


def _checks() -> tuple[Check, ...]:
    from planspace.demos.manifest import MANIFEST
    from planspace.embed import saved_embedding
    from planspace.embed.pixels import saved as saved_encoder
    from planspace.rl import history, saved_policy
    from planspace.storage import checkpoint
    from planspace.storage.arrays import read_arrays
    from planspace.storage.json_files import read_sealed

    return (
        Check(
            saved_embedding.DESCRIPTION,
            unreadable(lambda file: saved_embedding.load_embedding(file.parent)),
            set_aside_with=(saved_embedding.WEIGHTS,),
        ),
        Check(
            saved_encoder.DESCRIPTION,
            unreadable(lambda file: saved_encoder.load_image_encoder(file.parent)),
            set_aside_with=(saved_encoder.WEIGHTS,),
        ),
        Check(
            saved_policy.DESCRIPTION,
            unreadable(lambda file: saved_policy.load_policy(file.parent)),
            set_aside_with=(saved_policy.WEIGHTS, history.HISTORY),
        ),
        Check(
            history.HISTORY,
            unreadable(lambda file: history.load_history(file.parent)),
            set_aside_with=(saved_policy.WEIGHTS, saved_policy.DESCRIPTION),
        ),
        Check(checkpoint.FILE.name, unreadable(read_arrays)),
        Check("*.json", unreadable(read_sealed), folder="units"),
        Check(MANIFEST, _damaged_shards),
    )


def _damaged_shards(manifest: Path) -> Iterator[Damage]:
    from planspace.demos.folder import remove_damaged_shards

    try:
        damaged = remove_damaged_shards(manifest.parent)
    except PlanspaceError as error:
        yield Damage(manifest, str(error))
        return
    yield from (Damage(file, message) for file, message in damaged)
