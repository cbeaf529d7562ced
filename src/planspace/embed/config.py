"""Settings of training an embedding, and presets. Imports no JAX, so that `--help` answers at once."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Annotated, Any, Literal

from tyro.conf import arg

from planspace.embed.inputs import INPUT_TYPES, InputType
from planspace.embed.objective import PAGE, Objective, as_objective
from planspace.embed.objectives import OBJECTIVES
from planspace.embed.objectives.variational import Variational
from planspace.embed.time_head import TIME_INPUTS, TimeInput
from planspace.errors import UsageError, check_layers, check_setting, unknown
from planspace.seams import with_settings

PresetName = Literal["modern", "paper"]

PAPER_SPACINGS = (1, 3, 5, 10, 30)
"""Steps between the members of a triplet (paper, section on the variational embedding)."""
PAPER_HIDDEN = (64, 64)
"""Paper, section on the variational embedding: two hidden layers of 64 units."""


@dataclass(frozen=True)
class FitConfig:
    """Settings of training an embedding."""

    preset: PresetName = "modern"
    """The preset that the other settings come from. It decides how a seed is selected: `modern` by the
    midpoint error on the validation split, `paper` by the path error on the training split."""
    objective: Objective = field(default_factory=Variational)
    """What is minimised, and on which samples."""
    columns: Annotated[tuple[str, ...], arg(help_behavior_hint="(default: all)")] = ()
    """Names of the states that the encoder reads."""
    z_dim: int = 3
    """Number of dimensions of z; the paper has 3 and 10."""
    inputs: InputType = "trig"
    """`raw`: numbers as they are. `standard`: standardised, for plans in which windings matter. `trig`: sin
    and cos of angles on a circle, rotation matrices of quaternions, then standardised."""
    hidden: tuple[int, ...] = PAPER_HIDDEN
    """Units of the hidden layers of encoder and decoder."""
    spacings: Annotated[tuple[int, ...], arg(help_behavior_hint="(default: any three states)")] = ()
    """Steps between neighbouring states of a triplet."""
    short_fraction: float = 0.5
    """Without `spacings`: the fraction of triplets whose length is log-uniform, so mostly short; the others
    span most of a demonstration. Lower values give straighter plans; higher values give a z that helps
    policies more."""
    sigma_floor: float = 0.2
    """Smallest standard deviation of the decoder, in units of its inputs; without it the likelihood grows
    without bound."""
    steps: int = 6_000
    """Optimiser steps."""
    batch: int = 512
    """Triplets per step."""
    learning_rate: float = 2e-3
    """Initial learning rate of Adam."""
    decay: bool = True
    """Decrease the learning rate to zero along a cosine."""
    clip_norm: float | None = 10.0
    """Norm to which gradients are clipped."""
    average: float = 0.0
    """Decay of a running average of the weights, which is then saved; 0 saves the last weights."""
    z_std: float = 2.5
    """z is scaled after training until the root mean square of its standard deviations over the training
    states is this; 0 leaves z as trained, which is near 1."""
    whitening: float = 0.2
    """How much the standard deviations of z's principal directions are equalised after training: 0 not at
    all, 1 fully. Straight lines stay straight, and small directions become visible."""

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            UsageError: one is out of its range; the message names it.
        """
        for name, values in (
            ("z_dim", (self.z_dim,)),
            ("steps", (self.steps,)),
            ("batch", (self.batch,)),
            ("spacings", self.spacings),
        ):
            for value in values:
                check_setting(name, value, value >= 1, "at least 1")
        if self.hidden:
            check_layers("hidden", self.hidden)
        for name in ("sigma_floor", "z_std"):
            value = getattr(self, name)
            check_setting(name, value, 0 <= value < math.inf, "at least 0 and finite")
        for name in ("short_fraction", "whitening"):
            check_setting(name, getattr(self, name), 0 <= getattr(self, name) <= 1, "between 0 and 1")
        check_setting("average", self.average, 0 <= self.average < 1, "at least 0 and below 1")
        rate, norm = self.learning_rate, self.clip_norm
        check_setting("learning_rate", rate, 0 < rate < math.inf, "above 0 and finite")
        check_setting("clip_norm", norm, norm is None or norm > 0, "above 0")
        if self.inputs not in INPUT_TYPES:
            raise unknown("inputs", self.inputs, INPUT_TYPES)

    def with_objective(self, objective: str | Objective | Callable[..., Any]) -> "FitConfig":
        """Return these settings with another objective, see `find_objective`."""
        return replace(self, objective=find_objective(objective, self.objective))

    def with_settings(self, **changes: Any) -> "FitConfig":
        """Return these settings with some changed, the objective's own ones included.

        Args:
            changes: new values by name, for example `steps=100, linearity=2.0`.

        Raises:
            UsageError: neither these settings nor the objective have a setting of that name.
        """
        return with_settings(self, **changes)


@dataclass(frozen=True)
class TimeHeadConfig:
    """Settings of training the time head."""

    inputs: Annotated[TimeInput, arg(name="time-inputs")] = "state"
    """What the time head reads: the encoder's inputs, z, or both."""
    hidden: Annotated[tuple[int, ...], arg(name="time-hidden")] = (128, 128)
    """Units of the hidden layers of the time head."""
    features: Annotated[int, arg(name="time-features")] = 256
    """Number of features whose differences are compared."""
    steps: Annotated[int, arg(name="time-steps")] = 2_500
    """Optimiser steps of the time head."""
    batch: Annotated[int, arg(name="time-batch")] = 1024
    """Pairs of each kind per step."""
    learning_rate: Annotated[float, arg(name="time-learning-rate")] = 3e-3
    """Initial learning rate of Adam; it decreases to zero along a cosine."""
    slack: Annotated[float, arg(name="time-slack")] = 0.004
    """Root mean square by which the estimate may exceed the duration of an edge [s]."""
    farthest: Annotated[float, arg(name="time-farthest")] = 4.0
    """Random states are pushed apart up to about this time [s]."""
    softness: Annotated[float, arg(name="time-softness")] = 0.5
    """Width of the transition at `farthest` [s]."""
    plan_weight: Annotated[float, arg(name="time-plan-weight")] = 10.0
    """Weight of the squared error of times within demonstrations."""

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            UsageError: one is out of its range; the message names it.
        """
        counts = (("features", self.features), ("steps", self.steps), ("batch", self.batch))
        for name, value in counts:
            check_setting(f"time_{name}", value, value >= 1, "at least 1")
        if self.hidden:
            check_layers("time_hidden", self.hidden)
        for name in ("learning_rate", "slack", "farthest", "softness"):
            value = getattr(self, name)
            check_setting(f"time_{name}", value, 0 < value < math.inf, "above 0 and finite")
        weight = self.plan_weight
        check_setting("time_plan_weight", weight, 0 <= weight < math.inf, "at least 0 and finite")
        if self.inputs not in TIME_INPUTS:
            raise unknown("time_inputs", self.inputs, TIME_INPUTS)


def find_objective(given: str | Objective | Callable[..., Any], present: Objective) -> Objective:
    """Find an objective that replaces the present one.

    Args:
        given: the name of a shipped one, which keeps the weights that it shares with the present one, so that
            a preset's weights hold; or an objective or a function `loss(model, sample, *, key)`, which is
            taken as it is.
        present: the present one.

    Raises:
        UsageError: the name is unknown, or the object is not an `Objective`.
    """
    if not isinstance(given, str):
        return as_objective(given)
    if given not in OBJECTIVES:
        error = unknown("objective", given, OBJECTIVES)
        raise UsageError(f"{error} To write an Objective of your own, see {PAGE}.")
    return _share_weights(OBJECTIVES[given], present)


_RENAMED = {"near": "short_fraction", "z_deviation": "z_std"}
_RENAMED_WEIGHTS = {"anywhere": "off_data_weight"}


def update_saved(saved: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the settings of `FitConfig` that version 0.1.0 saved to today's names.

    Version 0.1.0 saved the weights of all objectives; those that the objective does not use are left out.

    Args:
        saved: plain data; settings under today's names stay as they are.
    """
    settings = {_RENAMED.get(name, name): value for name, value in saved.items()}
    weights = settings.get("objective")
    if isinstance(weights, Mapping) and weights.get("name") in OBJECTIVES:
        used = {"name"} | {f.name for f in _settings_of(OBJECTIVES[weights["name"]])}
        renamed = {_RENAMED_WEIGHTS.get(name, name): value for name, value in weights.items()}
        settings["objective"] = {name: value for name, value in renamed.items() if name in used}
    return settings


def _share_weights(new: Objective, old: Objective) -> Objective:
    names = {f.name for f in _settings_of(old)} & {f.name for f in _settings_of(new)}
    return replace(new, **{name: getattr(old, name) for name in names}) if is_dataclass(new) else new


def _settings_of(given: Any) -> tuple[Any, ...]:
    return fields(given) if is_dataclass(given) else ()


PRESETS: dict[PresetName, FitConfig] = {
    "modern": FitConfig(),
    "paper": FitConfig(
        preset="paper",
        objective=Variational(linearity=0.5, prior=1.0, off_data_weight=0.0),
        spacings=PAPER_SPACINGS,
        inputs="raw",
        z_std=0.0,
        whitening=0.0,
        sigma_floor=0.0,
        steps=200_000,  # the paper gives no length; the 2020 code took over 9 million
        batch=50,
        learning_rate=1e-3,
        decay=False,
        clip_norm=None,
    ),
}
"""`modern`: what measured best. `paper`: what the paper says and, where it is silent, what the 2020 code did.
The two are never mixed in one table."""
