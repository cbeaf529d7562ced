"""How a controller looks ahead: its settings, in one nested dataclass."""

import math
from dataclasses import dataclass, field
from typing import Literal

from planspace.control.method import PAGE, Method
from planspace.control.methods import MPPI
from planspace.control.splines import SplineOrder
from planspace.errors import UsageError, check_setting, check_whole
from planspace.seams import check_field_types, check_fits, unset_if

CostName = Literal["z", "time", "reward", "raw"]
"""What a controller minimises: the distance to the goal in z, the time to it, minus the task's reward, or the
distance of the standardised states, which are what the encoder reads."""


@dataclass(frozen=True)
class ControlConfig:
    """How a controller looks ahead."""

    method: Method = field(default_factory=MPPI)
    """How sampled controls become better ones."""
    horizon_s: float = 0.32
    """How far it looks ahead [s], rounded to control steps."""
    action_repeat: int = field(default=1, metadata=unset_if(1))
    """Steps of the task for which each control is held; their rewards are summed."""
    samples: int = 256
    """Candidates in each round."""
    cost: CostName = "z"
    """What it minimises: `z`, the distance to the goal in the embedding; `time`, the time to the goal, which
    needs an embedding with a time head; `reward`, minus the task's reward; or `raw`, the distance to the goal
    in the standardised states that the embedding reads."""
    knots: int = 4
    """Knots of a candidate's spline."""
    spline: SplineOrder = "linear"
    """How controls run between knots."""
    noise: float = 1.0
    """Standard deviation of the candidates' knots, in halves of the control's range."""
    noise_spread: float = 1.0
    """The noise of each candidate is divided by a number between 1 and this, so that some act finely."""
    noise_color: float = 0.0
    """Exponent of the noise's spectrum over the knots: 0 is white, 2 is Brownian."""
    cost_points: int = 4
    """States of the horizon in which distances are measured, evenly spaced; the last is its end."""
    terminal_weight: float = 2.5
    """Weight of the distance at the end of the horizon, relative to the mean distance along it."""
    ilqr_rounds: int = field(default=0, metadata=unset_if(0))
    """Rounds of iLQR that refine the controls after the samples, for a cost that is a distance. It pays with
    few samples (docs/appendix/control.md)."""
    effort_weight: float = 0.01
    """Cost of the largest control along the whole horizon, relative to the mean distance from where
    episodes start."""
    invalid_cost: float = 10.0
    """Cost of a horizon out of bounds or in a forbidden contact, in the same unit."""
    regulator: bool = True
    """Whether a linear regulator takes over where a simulation shows that it reaches and holds the goal."""
    follow_s: float = field(default=0.0, metadata=unset_if(0.0))
    """Above 0, the controller follows one of the plans it is given, where a simulation shows that a linear
    regulator along it reaches and holds the goal. Ten times a second, it tries the states of plans to which
    the regulator returns at the least cost, among those at most this long before the end of their plan
    [s]."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UsageError: a setting is out of its range, iLQR has no distance to lower, or the method does not
                fit the protocol `Method`.
        """
        check_fits(self.method, Method, PAGE)
        check_field_types(self)
        spread = self.noise_spread
        check_setting("noise_spread", spread, 1 <= spread < math.inf, "at least 1 and finite")
        rounds = getattr(self.method, "iterations", 1)
        check_whole("iterations", rounds)
        check_setting("horizon_s", self.horizon_s, 0 < self.horizon_s < math.inf, "above 0 and finite")
        for name in ("samples", "knots", "cost_points", "action_repeat"):
            check_setting(name, getattr(self, name), getattr(self, name) >= 1, "at least 1")
        check_setting("noise", self.noise, 0 < self.noise < math.inf, "above 0 and finite")
        check_setting("ilqr_rounds", self.ilqr_rounds, self.ilqr_rounds >= 0, "at least 0")
        if self.ilqr_rounds and self.cost == "reward":
            raise UsageError("ilqr_rounds needs a cost that is a distance: z, time or raw.")
        if self.follow_s and not self.regulator:
            raise UsageError(
                "follow_s needs the regulator, which holds the goal at the end of a plan: leave out "
                "follow_s, or leave the regulator on."
            )
        check_setting("follow_s", self.follow_s, 0 <= self.follow_s < math.inf, "at least 0 and finite")
        for name in ("noise_color", "terminal_weight", "effort_weight", "invalid_cost"):
            check_setting(
                name, getattr(self, name), 0 <= getattr(self, name) < math.inf, "at least 0 and finite"
            )
