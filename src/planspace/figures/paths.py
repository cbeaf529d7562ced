"""Demonstrations as paths in z: the data that the static and the interactive figure draw."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.embed.embedding import Embedding
from planspace.figures.projection import principal_components

MAX_DRAWN = 100
"""Default number of demonstrations in a figure; more would hide each other."""


@dataclass(frozen=True)
class Paths:
    """Demonstrations and their coordinates in a figure."""

    info: StateInfo
    """The states that the embedding reads."""
    numbers: tuple[int, ...]
    """The number of each demonstration in its dataset."""
    episodes: tuple[Episode, ...]
    """The demonstrations, with the states that the embedding reads."""
    points: tuple[Float[np.ndarray, "_time axis"], ...]
    """The coordinates of each demonstration."""
    labels: tuple[str, ...]
    """Labels of the two or three axes."""
    title: str
    """Title of the figure."""
    against_time: bool
    """Whether the first axis is time."""

    @property
    def is_3d(self) -> bool:
        """Whether there are three axes."""
        return len(self.labels) == 3

    @property
    def longest(self) -> float:
        """The longest duration [s]."""
        return max(float(e.times[-1]) for e in self.episodes)

    def time_left(self, i: int) -> Float[np.ndarray, " time"]:
        """Time left at each point of the i-th path [s]."""
        times = self.episodes[i].times
        return times[-1] - times


def embedded_paths(
    embedding: Embedding, demos: Demos, episodes: Int[np.ndarray, " demo"], most: int = MAX_DRAWN
) -> Paths:
    """Embed demonstrations and choose the axes to draw them on.

    A z with one dimension is drawn against time, with two in the plane, with three in space. With more, the
    first three principal components of z are drawn.

    Args:
        embedding: the embedding.
        demos: the demonstrations.
        episodes: the numbers of the demonstrations to draw.
        most: only this many are drawn, starting with the first.

    Raises:
        PlanspaceError: the demonstrations lack a state that the embedding reads.
    """
    demos = demos.select(embedding.inputs.names)
    drawn = episodes[:most]
    parts = tuple(demos.episode(int(i)) for i in drawn)
    z = embedding.encode(demos.states[demos.rows(drawn)])
    if embedding.z_dim == 1:
        z = np.stack([np.concatenate([e.times for e in parts]), z[:, 0]], axis=1)
        labels = ("time [s]", "z")
    elif embedding.z_dim <= 3:
        labels = tuple(f"z{k + 1}" for k in range(embedding.z_dim))
    else:
        z, fractions = principal_components(z, 3)
        labels = tuple(f"z component {k + 1} ({_percent(f)})" for k, f in enumerate(fractions))
    return Paths(
        info=demos.info,
        numbers=tuple(map(int, drawn)),
        episodes=parts,
        points=tuple(np.split(z, np.cumsum([len(e.states) for e in parts])[:-1])),
        labels=labels,
        title=_title(len(drawn), len(episodes), demos.info.problem, embedding.z_dim),
        against_time=embedding.z_dim == 1,
    )


def _title(num_drawn: int, num: int, problem: str, z_dim: int) -> str:
    what = f"{num_drawn} demonstrations" if num_drawn > 1 else "A demonstration"
    if num_drawn < num:
        what = f"The first {num_drawn} of {num} demonstrations"
    of_problem = f" of {problem}" if problem else ""
    against = " against time" if z_dim == 1 else ""
    dimensions = "1 dimension" if z_dim == 1 else f"{z_dim} dimensions"
    return f"{what}{of_problem} in plan space{against} (z has {dimensions})"


def _percent(fraction: float) -> str:
    return "< 1 %" if 0 < fraction < 0.005 else f"{100 * fraction:.0f} %"
