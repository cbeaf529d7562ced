"""Provenance: the versions of the libraries that computed an artefact."""

import importlib.metadata
from dataclasses import asdict, dataclass
from typing import Literal

import planspace

Library = Literal["mujoco", "jax"]


@dataclass(frozen=True)
class Provenance:
    """Versions of the libraries on which the numbers of an artefact depend."""

    planspace: str
    mujoco: str | None = None
    """None if the artefact does not depend on it."""
    jax: str | None = None
    """None if the artefact does not depend on it."""

    @classmethod
    def current(cls, *libraries: Library) -> "Provenance":
        """Describe this installation, without importing the libraries.

        Args:
            libraries: those that the artefact depends on besides planspace.
        """
        versions = {name: importlib.metadata.version(name) for name in libraries}
        return cls(planspace.__version__, **versions)

    def plain(self) -> dict[str, str]:
        """The versions by library, as files keep them under `versions`."""
        return {name: version for name, version in asdict(self).items() if version is not None}
