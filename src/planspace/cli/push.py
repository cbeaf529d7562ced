"""`planspace push`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


@dataclass(frozen=True)
class Push:
    """Upload an embedding, plans or policies to the Hugging Face hub.

    This needs the extra `hub` and a login by `hf auth login`. The printed address, hf://OWNER/NAME@COMMIT,
    can be given wherever an embedding, plans or policies are read.
    """

    folder: Positional[Annotated[Path, arg(metavar="DIR")]]
    """The folder of an embedding, a dataset or a training run."""
    repo: Positional[Annotated[str, arg(metavar="OWNER/NAME")]]
    """The repository. It is made if it does not exist."""
    private: bool = False
    """Make a new repository private."""

    def __call__(self) -> None:
        """Upload, and print the address."""
        from planspace.storage.hub import push_to_hub

        print(push_to_hub(self.folder, self.repo, private=self.private))
