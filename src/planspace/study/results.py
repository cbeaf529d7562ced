"""The result of a unit: declared types, and how they are written to and read from JSON."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Metrics = Mapping[str, int | float | None]
"""Geometry metrics by name; None if not finite."""


@dataclass(frozen=True)
class PlansResult:
    """What a dataset of demonstrations contains."""

    count: int
    """Number of demonstrations."""
    median_duration_s: float
    reached: float
    """Fraction of demonstrations that end within the tolerance of their goal."""
    hash: str = ""
    """Hash of the dataset's content."""


@dataclass(frozen=True)
class FitResult:
    """What a trained embedding measures."""

    seed: int
    """The selected seed."""
    metrics: Metrics
    """Geometry on test demonstrations."""
    raw_state: Metrics = field(default_factory=dict)
    """The same metrics of the standardised raw state."""
    paths: tuple[Any, ...] = ()
    """Test demonstrations in z as [path][state][principal component]; empty if not kept."""
    log_steps: tuple[int, ...] = ()
    """Optimiser steps of the rows of `path_error` and `bound`; empty if the fit has a closed form."""
    path_error: tuple[Any, ...] = ()
    """Path error during training, [row][seed]."""
    bound: tuple[Any, ...] = ()
    """Bound during training, [row][seed]."""
    hash: str = ""
    """Hash of the embedding's content."""


@dataclass(frozen=True)
class Film:
    """An episode as a stick figure."""

    seed: int
    """The seed of the policy."""
    seconds: float
    """Time between two poses."""
    poses: tuple[Any, ...]
    """[pose][line] as x0, y0, x1, y1 in mm."""


@dataclass(frozen=True)
class PoliciesResult:
    """The returns of a few seeds of an arm."""

    seeds: tuple[int, ...]
    steps: tuple[int, ...]
    """Environment steps of a seed at the end of each row."""
    returns: tuple[Any, ...]
    """Mean return of the iterations of each row, [row][seed]."""
    frozen: tuple[bool, ...]
    """Whether each seed diverged."""
    eval_steps: tuple[int, ...] = ()
    """Environment steps of a seed at each evaluation."""
    eval_returns: tuple[Any, ...] = ()
    """Mean return of each evaluation, [evaluation][seed]; None if not finite."""
    embeddings: tuple[str, ...] = ()
    """Hashes of the embeddings."""
    film: Film | None = None
    """An episode of the best seed; None if not kept."""


Found = PlansResult | FitResult | PoliciesResult


@dataclass(frozen=True)
class UnitResult:
    """What a finished unit found, and how long it took."""

    found: Found
    seconds: float
    cores: int
    resumed: bool = False
    """Whether it was interrupted, so that `seconds` is not all of its time."""
    cpu: str = ""
    """Model of the CPU it ran on; empty if not recorded."""

    @property
    def core_seconds(self) -> float:
        """Seconds times cores."""
        return self.seconds * self.cores


_TYPES: dict[str, type[Found]] = {"plans": PlansResult, "fit": FitResult, "policies": PoliciesResult}


def result_from_json(kind: str, data: Mapping[str, Any]) -> UnitResult:
    """Reads the result of a unit.

    Args:
        kind: `plans`, `fit` or `policies`.
        data: the JSON object.
    """
    found: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in data["found"].items()}
    if film := found.get("film"):
        found["film"] = Film(film["seed"], film["seconds"], tuple(film["poses"]))
    return UnitResult(
        _TYPES[kind](**found), data["seconds"], data["cores"], data["resumed"], data.get("cpu", "")
    )
