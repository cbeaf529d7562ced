"""The result of a unit: declared types, and how to read them from JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Metrics = Mapping[str, int | float | None]
"""Geometry metrics by name; None if not finite."""
SeedRow = Sequence[float | None]
"""One number per seed; None if not finite."""
Paths = Sequence[Sequence[Sequence[float]]]
"""Demonstrations in z as [path][state][principal component]."""


@dataclass(frozen=True)
class PlansResult:
    """The result of planning, or of control that makes demonstrations: facts about them."""

    count: int
    """Number of demonstrations."""
    median_duration_s: float
    reached: float
    """Fraction of plans that end within the tolerance of their goal, or of episodes that control held
    there."""
    hash: str = ""
    """Hash of the dataset's content."""
    simulated_steps: int | None = field(default=None, compare=False)
    """Physics steps that planner or control took, over all simulations; None if not counted."""


@dataclass(frozen=True)
class FitResult:
    """The result of training an embedding."""

    seed: int
    """The selected seed."""
    metrics: Metrics
    """Geometry on test demonstrations."""
    raw_state: Metrics = field(default_factory=dict)
    """The same metrics of the standardised raw state."""
    paths: Paths = ()
    """Test demonstrations; empty if not stored."""
    log_steps: tuple[int, ...] = ()
    """Optimiser steps of the rows of `path_error` and `bound`; empty if the fit has a closed form."""
    path_error: tuple[SeedRow, ...] = ()
    """Path error during training, [row][seed]."""
    bound: tuple[SeedRow, ...] = ()
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
    poses: Sequence[Sequence[Sequence[int]]]
    """[pose][line] as x0, y0, x1, y1 in mm."""


@dataclass(frozen=True)
class PoliciesResult:
    """The returns of a few seeds of an arm."""

    seeds: tuple[int, ...]
    steps: tuple[int, ...]
    """Environment steps of a seed at the end of each row."""
    returns: tuple[SeedRow, ...]
    """Mean return of the iterations of each row, [row][seed]."""
    frozen: tuple[bool, ...]
    """Whether each seed diverged."""
    eval_steps: tuple[int, ...] = ()
    """Environment steps of a seed at each evaluation."""
    eval_returns: tuple[SeedRow, ...] = ()
    """Mean return of each evaluation, [evaluation][seed]."""
    embeddings: tuple[str, ...] = ()
    """Hashes of the embeddings."""
    film: Film | None = None
    """An episode of the best seed; None if not stored."""


Found = PlansResult | FitResult | PoliciesResult


@dataclass(frozen=True)
class UnitResult:
    """The result of a finished unit, and how long it took."""

    found: Found
    seconds: float
    cores: int
    resumed: bool = False
    """Whether the unit was interrupted, so that `seconds` counts only the last part."""
    cpu: str = ""
    """Model of the CPU it ran on; empty if not recorded."""

    @property
    def core_seconds(self) -> float:
        """Seconds times cores."""
        return self.seconds * self.cores


_TYPES: dict[str, type[Found]] = {
    "plans": PlansResult,
    "guide": PlansResult,
    "fit": FitResult,
    "policies": PoliciesResult,
}


def result_from_json(kind: str, data: Mapping[str, Any]) -> UnitResult:
    """Read the result of a unit.

    Args:
        kind: `plans`, `fit`, `guide` or `policies`.
        data: the JSON object.
    """
    found: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in data["found"].items()}
    if film := found.get("film"):
        found["film"] = Film(film["seed"], film["seconds"], tuple(film["poses"]))
    return UnitResult(
        _TYPES[kind](**found), data["seconds"], data["cores"], data["resumed"], data.get("cpu", "")
    )
