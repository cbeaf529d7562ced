"""The forms in which a task is observed and rewarded. Imports nothing, so that `--help` answers at once."""

from typing import Literal, get_args

RewardType = Literal["dense", "sparse", "2020"]
"""`dense`: the task's reward; `sparse`: 1 at the goal and 0 elsewhere; `2020`: the swing-up's as the code of
2020 had it, forces without limit."""

ObservationType = Literal["raw", "wrapped", "trig"]
"""`raw`: what the task observes, angles as they are; `wrapped`: the same with angles on a circle brought to
(-pi, pi]; `trig`: raw with sin and cos of its angles."""
OBSERVATION_TYPES: tuple[ObservationType, ...] = get_args(ObservationType)
