"""Settings of training an encoder of pictures. Imports no JAX, so that `--help` answers at once."""

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal, get_args

from tyro.conf import arg

from planspace.embed.objective import Objective
from planspace.embed.objectives.variational import Variational
from planspace.errors import UsageError, check_layers, check_setting
from planspace.physics.pictures import PictureConfig
from planspace.seams import unset_if

Target = Literal["z", "state", "random", "pictures"]
TARGETS: tuple[Target, ...] = get_args(Target)
STRIDE = 2
"""Each convolution halves the picture."""


@dataclass(frozen=True)
class PictureSpaceConfig:
    """Settings of a plan space that is learned from pictures alone: the target `pictures`."""

    objective: Objective = field(default_factory=lambda: Variational(linearity=200.0))
    """What is minimised, on triplets of stacks of pictures."""
    z_dim: int = 4
    """Number of dimensions of z."""
    picture_weight: float = 400.0
    """Weight of a picture's likelihood, which is a mean over its numbers: it counts as so many numbers."""
    warm_up: float = 0.5
    """In this fraction of the steps, the loss changes gradually from that of a variational auto-encoder to
    that of the objective. A large `linearity` from the start makes all z equal."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_setting("z_dim", self.z_dim, self.z_dim >= 1, "at least 1")
        weight = self.picture_weight
        check_setting("picture_weight", weight, 0 < weight < math.inf, "positive and finite")
        check_setting("warm_up", self.warm_up, 0 <= self.warm_up <= 1, "from 0 to 1")


@dataclass(frozen=True)
class ImageFitConfig:
    """Settings of training an encoder of pictures."""

    target: Target = "z"
    """What the network is trained to output. `z`: the teacher's z. `state`: the state, from which the teacher
    computes z. `random`: z, but only the last layer is trained, and the others keep their random weights.
    `pictures`: a z of its own. There is no teacher; an objective is minimised on pictures of plans."""
    stacks: int = 20_000
    """Number of training stacks off the plans. They are kept in memory: 37 kB each with the default pictures.
    With the target `pictures`, those of the plans are added."""
    noisy_fraction: float = 0.5
    """Fraction of the training states that are moved off the plans."""
    noise: float = 0.5
    """How far they are moved, as a fraction of the standard deviation of each number over the plans."""
    start_fraction: float = 0.1
    """Fraction of the stacks whose earlier frames repeat, as at the start of an episode."""
    frame_s: Annotated[float | None, arg(help_behavior_hint="(default: the task's control step)")] = None
    """Time between two frames of a stack [s]. It must be the control step where the encoder is used."""
    channels: tuple[int, ...] = (16, 32, 32, 32)
    """Channels of the convolutions, each of which halves the picture."""
    hidden: int = 128
    """Units of the layer behind the convolutions, and of the two hidden layers that draw pictures."""
    steps: int = 4_000
    """Optimiser steps."""
    batch: int = 64
    """Stacks per step. With the target `pictures` they are in fours: a triplet, and one off the plans."""
    learning_rate: float = 2e-3
    """Initial learning rate of Adam; it decreases to zero along a cosine."""
    pictures: PictureConfig = field(default_factory=PictureConfig)
    space: PictureSpaceConfig = field(
        default_factory=PictureSpaceConfig, metadata=unset_if(PictureSpaceConfig())
    )

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.target not in TARGETS:
            raise UsageError(f"`target` must be one of {', '.join(TARGETS)}, got {self.target!r}.")
        if self.target != "pictures" and self.space != PictureSpaceConfig():
            raise UsageError(
                "objective, z_dim, picture_weight and warm_up are settings of the target 'pictures': with "
                f"the target {self.target!r}, the teacher has them."
            )
        for name in ("stacks", "steps", "batch"):
            check_setting(name, getattr(self, name), getattr(self, name) >= 1, "at least 1")
        check_layers("hidden", (self.hidden,))
        for name in ("noisy_fraction", "start_fraction"):
            check_setting(name, getattr(self, name), 0 <= getattr(self, name) <= 1, "from 0 to 1")
        check_setting("noise", self.noise, 0 <= self.noise < math.inf, "at least 0 and finite")
        rate = self.learning_rate
        check_setting("learning_rate", rate, 0 < rate < math.inf, "positive and finite")
        step = self.frame_s
        check_setting("frame_s", step, step is None or 0 < step < math.inf, "positive and finite")
        check_channels(self.channels, self.pictures)


def check_channels(channels: tuple[int, ...], pictures: PictureConfig) -> None:
    """Check that each convolution can halve the picture.

    Raises:
        UsageError: there are no channels, or width or height cannot be halved as often.
    """
    check_setting("channels", channels, len(channels) > 0 and min(channels) >= 1, "numbers of at least 1")
    factor = max(STRIDE ** len(channels), BLOCK)
    for name, value in (("width", pictures.width), ("height", pictures.height)):
        wanted = f"a multiple of {factor}, which {len(channels)} convolutions need"
        check_setting(name, value, value % factor == 0, wanted)


BLOCK = 4
"""Width and height of the blocks of pixels whose mean `Appearance` looks at."""
