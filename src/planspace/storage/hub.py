"""Embeddings, plans and policies on the Hugging Face hub (extra `hub`).

A repository holds the files of one folder: safetensors, JSON, and README.md as the card. A pull names the
hash of a commit, so that what it returns never changes, and is kept on this machine. Nothing is unpickled,
and no code is read: a repository with any other file is refused.
"""

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from planspace.errors import PlanspaceError, UsageError, install_command, quoted
from planspace.storage.files import make_folder
from planspace.storage.json_files import read_sealed

REPO = r"(?:datasets/)?[\w.-]+/[\w.-]+"
ADDRESS = re.compile(rf"hf://({REPO})@(.+)")
COMMIT = re.compile(r"[0-9a-f]{40}")
PARTS = {
    "embedding.json": ("embedding.safetensors",),
    "policies.json": ("policies.safetensors", "embedding/*", "embedding-*/*"),
    "manifest.json": ("shard-*.safetensors", "trees/*.safetensors"),
}
"""The description in a folder, and the other files that belong to it, apart from the card."""
CARD = "README.md"
ACCEPTED = re.compile(
    r"(?:(?:embedding(?:-\d+)?|trees)/)?[\w-]+\.(?:safetensors|json)|(?:[\w-]+/)?README\.md"
)
BY_THE_HUB = ".gitattributes"
"""The hub adds this file to every repository; it is not pulled."""


def push_to_hub(folder: str | Path, repo_id: str, *, private: bool = False) -> str:
    """Upload an embedding, plans or policies to the Hugging Face hub.

    The repository is made if it does not exist: a dataset for plans, a model for the others. Logs,
    checkpoints and settings of a run stay here. Log in with `hf auth login` before.

    Args:
        folder: the folder of an embedding, a dataset of plans, or a training run.
        repo_id: the repository, `owner/name`.
        private: whether a new repository is private.

    Returns:
        The address of the upload, `hf://owner/name@commit`, which loads it wherever a folder is expected.

    Raises:
        UsageError: the folder or the name of the repository does not fit.
        PlanspaceError: the folder is damaged or its model has several files, huggingface_hub is not
            installed, or the hub is unreachable or refuses the upload.
    """
    path, name = Path(folder), repo_id.removeprefix("datasets/")
    description = next((file for file in PARTS if (path / file).is_file()), None)
    if description is None:
        raise UsageError(f"{path} is not an embedding, a dataset of plans or a training run.")
    if not re.fullmatch(r"[\w.-]+/[\w.-]+", name):
        raise UsageError(f"a repository on the hub is owner/name, got {quoted(repo_id)}.")
    read_sealed(path / description)
    if description == "manifest.json" and (path / "model").is_dir():
        raise PlanspaceError(
            f"{path} holds a model of several files in {path / 'model'}; only safetensors, JSON and {CARD} "
            "are uploaded. Use a model in one XML file, or pass the folder on in another way."
        )
    patterns = (description, CARD, *PARTS[description])
    names = [file.relative_to(path).as_posix() for pattern in patterns for file in path.glob(pattern)]
    kind = "dataset" if description == "manifest.json" else "model"
    with _explained(f"push to {name}") as api:
        api.create_repo(name, repo_type=kind, private=private, exist_ok=True)
        _check_files(name, api.list_repo_files(name, repo_type=kind))
        done = api.upload_folder(
            repo_id=name,
            repo_type=kind,
            folder_path=path,
            allow_patterns=[file for file in names if ACCEPTED.fullmatch(file)],
            commit_message="Upload by planspace",
        )
    return f"hf://{'datasets/' if kind == 'dataset' else ''}{name}@{done.oid}"


def pull_from_hub(repo_id: str, revision: str) -> Path:
    """Download a repository that `push_to_hub` made, and return its folder.

    The folder is kept in the user's cache folder, so the same call needs the network once.

    Args:
        repo_id: the repository, `owner/name`; `datasets/owner/name` for plans.
        revision: the hash of the commit, 40 digits; a branch or a tag could change.

    Raises:
        UsageError: the name or the revision has another form.
        PlanspaceError: the repository holds other files, huggingface_hub is not installed, or the hub is
            unreachable or does not have this revision.
    """
    if not re.fullmatch(REPO, repo_id):
        raise UsageError(f"a repository on the hub is owner/name, got {quoted(repo_id)}.")
    if not COMMIT.fullmatch(revision):
        raise UsageError(
            f"{repo_id}: the revision must be the hash of a commit (40 hexadecimal digits), because a branch "
            f"or a tag may change; got {quoted(revision)}. `planspace push` prints it."
        )
    name = repo_id.removeprefix("datasets/")
    kind = "model" if name == repo_id else "dataset"
    target = _cache() / f"{kind}--{name.replace('/', '--')}" / revision
    if target.is_dir():
        return target
    make_folder(target.parent)
    staging = Path(tempfile.mkdtemp(dir=target.parent, prefix=".pulling-"))
    try:
        with _explained(f"pull {repo_id}") as api:
            files = _check_files(name, api.list_repo_files(name, revision=revision, repo_type=kind))
            api.snapshot_download(
                name, repo_type=kind, revision=revision, local_dir=staging, allow_patterns=files
            )
        shutil.rmtree(staging / ".cache", ignore_errors=True)  # of huggingface_hub
        if not target.is_dir():  # another process may have been faster
            os.replace(staging, target)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return target


def pull_address(address: str) -> Path | None:
    """Download what an address of the form `hf://owner/name@commit` names.

    Returns:
        Its folder; None if the text is not an address of the hub.

    Raises:
        UsageError: the address has no revision, or as `pull_from_hub`.
        PlanspaceError: as `pull_from_hub`.
    """
    if not address.startswith("hf:/"):
        return None
    whole = f"hf://{address.removeprefix('hf:').lstrip('/')}"  # `Path` makes one slash of two
    found = ADDRESS.fullmatch(whole)
    if found is None:
        raise UsageError(f"an address on the hub is hf://owner/name@commit, got {quoted(whole)}.")
    return pull_from_hub(found[1], found[2])


def _check_files(name: str, files: list[str]) -> list[str]:
    """Return the files of a repository that belong to planspace; refuse it if there are others."""
    ours = [file for file in files if file != BY_THE_HUB]
    for file in ours:
        if not ACCEPTED.fullmatch(file):
            raise PlanspaceError(
                f"{name} on the hub holds {quoted(file)}; only safetensors, JSON and {CARD} are accepted. "
                "Choose a repository that holds nothing else."
            )
    return ours


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "planspace-hub"


@contextmanager
def _explained(what: str) -> Iterator[Any]:
    """Give the client of the hub, and turn its errors into one line."""
    try:
        import huggingface_hub
        from huggingface_hub.errors import HfHubHTTPError
    except ModuleNotFoundError as error:
        raise PlanspaceError(f"the hub needs huggingface_hub: {install_command('hub')}.") from error
    try:
        yield huggingface_hub.HfApi()
    except PlanspaceError:
        raise
    except HfHubHTTPError as error:  # the hub has answered
        raise PlanspaceError(f"cannot {what}: the hub refused it: {_one_line(error)}") from error
    except Exception as error:  # whatever the libraries of the network raise
        raise PlanspaceError(
            f"cannot {what} ({type(error).__name__}: {_one_line(error)}). Check that huggingface.co can be "
            "reached from here, and that HF_HUB_OFFLINE is not set."
        ) from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
