"""The ready-made artefacts that the package brings: plans, an embedding, sometimes policies, by task.

planspace/ready/NAME/plans, embedding, policy    the folders that planspace itself writes
planspace/ready/SHA256SUMS                       the hash of every file

`benchmarks/make_artefacts.py` makes them. Wherever a folder is read, the name of an artefact stands for its
folder, and so does an address on the hub; a folder of that name wins.
"""

from os import PathLike
from pathlib import Path

from planspace.errors import UsageError, did_you_mean, quoted
from planspace.storage.hub import pull_address

READY = Path(__file__).parent.parent / "ready"
HASHES = READY / "SHA256SUMS"
PLANS, EMBEDDING, POLICY = "plans", "embedding", "policy"
"""The parts of an artefact."""


def ready_names(part: str) -> list[str]:
    """Return the names of the artefacts that have a part, sorted."""
    return sorted(folder.parent.name for folder in READY.glob(f"*/{part}"))


def find_folder(path: str | Path, part: str) -> Path:
    """Return the folder that a path, the name of a ready-made artefact or an address on the hub stands for.

    Args:
        path: a path, a name in `ready_names(part)`, or `hf://owner/name@commit`. A path that exists wins.
        part: `plans`, `embedding` or `policy`.

    Returns:
        The path itself if it exists or is more than a name; its reader then says what is wrong with it.

    Raises:
        UsageError: it is not a path, or a name that neither a folder nor an artefact has; the nearest name is
            suggested.
        PlanspaceError: the hub does not give what the address names; see `hub.pull_from_hub`.
    """
    if not isinstance(path, str | PathLike):
        raise UsageError(f"expected a folder or a ready-made name, got {quoted(path)}.")
    found = Path(path)
    if not found.exists() and (pulled := pull_address(str(path))) is not None:
        return pulled
    if found.exists() or found.is_absolute() or len(found.parts) != 1 or str(path) != found.name:
        return found
    if found.name in ready_names(part):
        return READY / found.name / part
    names = ready_names(part)
    raise UsageError(
        f"there is no folder {quoted(found.name)} and no ready-made artefact of this name."
        f"{did_you_mean(found.name, names)} Ready-made {part}: {', '.join(names)}."
    )
