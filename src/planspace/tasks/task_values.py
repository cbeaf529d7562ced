"""Reading and writing the section `task` of a problem file."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from planspace.errors import unknown
from planspace.tasks import problem_values as values
from planspace.tasks.observation_types import OBSERVATION_TYPES, ObservationType
from planspace.tasks.strict_yaml import short
from planspace.tasks.task_settings import RewardSettings, TaskSettings, Termination


def task_settings(value: Any) -> TaskSettings:
    """Read the section `task`.

    Raises:
        ValueError: a key is unknown, or a value cannot be read.
        TypeError: a value has the wrong type.
    """
    given, default = _section(value, TaskSettings, "task"), TaskSettings()
    return TaskSettings(
        horizon_s=values.read(given, "horizon_s", values.positive, default.horizon_s),
        control_step_s=values.read(given, "control_step_s", values.positive, default.control_step_s),
        observation=values.read(given, "observation", _observation, default.observation),
        tolerance=values.read(given, "tolerance", values.positive, None),
        reward=values.read(given, "reward", _reward, default.reward),
        termination=values.read(given, "termination", _termination, default.termination),
    )


def _observation(value: Any) -> ObservationType:
    for name in OBSERVATION_TYPES:
        if name == value:
            return name
    raise ValueError(str(unknown("observation", short(value), OBSERVATION_TYPES)))


def _reward(value: Any) -> RewardSettings:
    if value in ("sparse", "dense"):
        return RewardSettings(sparse=value == "sparse")
    if isinstance(value, str):
        raise ValueError(str(unknown("reward", short(value), ["sparse", "dense"])))
    given, default = _section(value, RewardSettings, "reward", left_out=("sparse",)), RewardSettings()
    return RewardSettings(
        distance=values.read(given, "distance", values.weights, ()),
        max_distance=values.read(given, "max_distance", values.positive, default.max_distance),
        effort=values.read(given, "effort", _weight, default.effort),
        bonus=values.read(given, "bonus", _weight, default.bonus),
        alive=values.read(given, "alive", _weight, None),
    )


def _termination(value: Any) -> Termination:
    given = _section(value, Termination, "termination")
    return Termination(
        bounds=values.read(given, "bounds", values.flag, False),
        contacts=values.read(given, "contacts", values.flag, False),
        below=values.read(given, "below", _levels, ()),
    )


def _levels(value: Any) -> tuple[tuple[str, float], ...]:
    if not isinstance(value, dict) or not value:
        raise TypeError(f"expected names of the state with their lowest values, got {short(value)}")
    return tuple((values.text(name), values.numbers([level])[0]) for name, level in value.items())


def _weight(value: Any) -> float:
    return values.weights([value])[0]


def _section(value: Any, kind: type, what: str, left_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """The keys and values of a section, all of them fields of a dataclass."""
    if not isinstance(value, dict):
        raise TypeError(f"expected keys and values, got {short(value)}")
    known = [f.name for f in fields(kind) if f.name not in left_out]
    for key in value:
        if key not in known:
            raise ValueError(str(unknown(f"key of {what}", short(key).strip("'"), known)))
    return value


def plain_task_settings(settings: TaskSettings) -> dict[str, Any]:
    """Return the section `task` that `task_settings` reads, with every value written out."""
    reward, ends = settings.reward, settings.termination
    return _without_none(
        {
            "horizon_s": settings.horizon_s,
            "control_step_s": settings.control_step_s,
            "observation": settings.observation,
            "tolerance": settings.tolerance,
            "reward": "sparse"
            if reward.sparse
            else _without_none(
                {
                    "distance": list(reward.distance),
                    "max_distance": reward.max_distance,
                    "effort": reward.effort,
                    "bonus": reward.bonus,
                    "alive": reward.alive,
                }
            ),
            "termination": _without_none(
                {"bounds": ends.bounds, "contacts": ends.contacts, "below": dict(ends.below) or None}
            ),
        }
    )


def _without_none(given: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in given.items() if value is not None}
