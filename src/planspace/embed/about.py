"""How an embedding was trained and measured: the object `about` in `embedding.json`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

Value = TypeVar("Value")
Metrics = Mapping[str, int | float | None]
"""The fields of `planspace.embed.geometry.Geometry`, by name; None if there is nothing to measure."""
SPLITS = ("train", "validation", "test")


@dataclass(frozen=True)
class TrainingSettings:
    """The settings that determine a training; `config.json` holds the same."""

    demos: str
    """SHA-256 of the content of the demonstrations."""
    seeds: tuple[int, ...]
    """The seeds that were trained."""
    split_seed: int
    """Seed of the split of the demonstrations."""
    fit: Mapping[str, Any]
    """`FitConfig` as plain data, under the names of the version that saved it."""


@dataclass(frozen=True)
class ObjectiveSummary:
    """What an embedding was trained on."""

    name: str
    summary: str
    """One sentence."""
    closed_form: bool
    """Whether the solution was computed without training steps."""


@dataclass(frozen=True)
class About:
    """How an embedding was trained and measured."""

    preset: str
    seed: int
    """The selected seed."""
    settings: TrainingSettings
    objective: ObjectiveSummary | None
    """None if version 0.1.0 saved the embedding."""
    problem: str | None
    """Name of the planning problem of the demonstrations; None if they have none."""
    split: Mapping[str, tuple[int, ...]]
    """Indices of the demonstrations in each of `SPLITS`."""
    metrics: Mapping[str, Metrics]
    """The geometry on each of `SPLITS`."""
    intervals: Mapping[str, Mapping[str, tuple[float, float]]]
    """By split, the 95 % interval of each metric over demonstrations."""
    metrics_raw_state: Metrics
    """The geometry of the standardised raw state on the test split."""
    metrics_constant: Metrics
    """The geometry of a constant z on the test split."""
    metrics_of_seeds: Mapping[int, Metrics]
    """The geometry of each trained seed on the validation split."""
    versions: Mapping[str, str]
    """Versions of the libraries that computed it."""

    def plain(self) -> dict[str, Any]:
        """Return plain data for JSON, which `read_about` reads."""
        plain = asdict(self)
        if self.objective is None:
            del plain["objective"]
        return plain


def read_about(saved: Mapping[str, Any]) -> About | None:
    """Read what `About.plain` returned and a file stored; None if it is empty.

    Raises:
        KeyError: a value is missing.
        TypeError, ValueError, AttributeError: a value has the wrong type.
    """
    if not saved:
        return None
    settings, objective, problem = saved["settings"], saved.get("objective"), saved["problem"]
    return About(
        preset=_checked(saved["preset"], str),
        seed=_checked(saved["seed"], int),
        settings=TrainingSettings(
            demos=_checked(settings["demos"], str),
            seeds=_integers(settings["seeds"]),
            split_seed=_checked(settings["split_seed"], int),
            fit=_checked(settings["fit"], dict),
        ),
        objective=None if objective is None else _objective(objective),
        problem=None if problem is None else _checked(problem, str),
        split={name: _integers(saved["split"][name]) for name in SPLITS},
        metrics={name: _metrics(saved["metrics"][name]) for name in SPLITS},
        intervals={name: _intervals(part) for name, part in saved["intervals"].items()},
        metrics_raw_state=_metrics(saved["metrics_raw_state"]),
        metrics_constant=_metrics(saved["metrics_constant"]),
        metrics_of_seeds={int(seed): _metrics(part) for seed, part in saved["metrics_of_seeds"].items()},
        versions={name: _checked(version, str) for name, version in saved["versions"].items()},
    )


def _objective(saved: Mapping[str, Any]) -> ObjectiveSummary:
    return ObjectiveSummary(
        _checked(saved["name"], str), _checked(saved["summary"], str), _checked(saved["closed_form"], bool)
    )


def _metrics(saved: Mapping[str, Any]) -> Metrics:
    return {name: None if value is None else _number(value) for name, value in saved.items()}


def _intervals(saved: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    return {name: (float(_number(low)), float(_number(high))) for name, (low, high) in saved.items()}


def _integers(saved: Any) -> tuple[int, ...]:
    return tuple(_checked(value, int) for value in _checked(saved, list))


def _number(value: Any) -> int | float:
    if type(value) not in (int, float):
        raise TypeError(f"expected a number, got {value!r:.60}")
    return value


def _checked(value: Any, kind: type[Value]) -> Value:
    if type(value) is not kind:
        raise TypeError(f"expected {kind.__name__}, got {value!r:.60}")
    return value
