"""Demonstrations as paths in z: the data that the static and the interactive figure draw."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.demos.state_info import StateInfo
from planspace.embed.embedding import Embedding
from planspace.figures.projection import principal_components
from planspace.figures.thinning import thin_paths

MAX_DRAWN = 100
"""Default number of demonstrations in a figure; more would hide each other."""
MAX_POINTS = 20_000
"""Default number of states in a figure; of longer paths, some states are left out."""


@dataclass(frozen=True)
class Paths:
    """Demonstrations and their coordinates in a figure."""

    info: StateInfo
    """The states that the embedding reads."""
    numbers: tuple[int, ...]
    """The number of each demonstration in its dataset."""
    times: tuple[Float[np.ndarray, " _time"], ...]
    """Time of each point [s]."""
    states: tuple[Float[np.ndarray, "_time state"], ...]
    """The state of each point: the numbers that the embedding reads."""
    points: tuple[Float[np.ndarray, "_time axis"], ...]
    """The coordinates of each demonstration."""
    num_states: int
    """Number of states before thinning."""
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
        return max(float(times[-1]) for times in self.times)

    def time_left(self, i: int) -> Float[np.ndarray, " time"]:
        """Time left at each point of the i-th path [s]."""
        return self.times[i][-1] - self.times[i]


def embedded_paths(
    embedding: Embedding,
    demos: Demos,
    episodes: Int[np.ndarray, " demo"],
    most: int = MAX_DRAWN,
    most_points: int = MAX_POINTS,
) -> Paths:
    """Embed demonstrations and choose the axes to draw them on.

    A z with one dimension is drawn against time, with two in the plane, with three in space. With more, the
    first three principal components of z are drawn.

    Args:
        embedding: the embedding.
        demos: the demonstrations.
        episodes: the numbers of the demonstrations to draw.
        most: only this many are drawn, starting with the first.
        most_points: about this many states are drawn; see `planspace.figures.thinning`.

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
    points = np.split(z, np.cumsum([len(e.states) for e in parts])[:-1])
    kept = thin_paths(points, most_points)
    return Paths(
        info=demos.info,
        numbers=tuple(map(int, drawn)),
        times=tuple(e.times[k] for e, k in zip(parts, kept, strict=True)),
        states=tuple(e.states[k] for e, k in zip(parts, kept, strict=True)),
        points=tuple(p[k] for p, k in zip(points, kept, strict=True)),
        num_states=len(z),
        labels=labels,
        title=_title(len(drawn), len(episodes), demos.info.problem, embedding.z_dim)
        + thinned_note(sum(map(len, kept)), len(z)),
        against_time=embedding.z_dim == 1,
    )


def thinned_note(num_drawn: int, num: int) -> str:
    """The end of a title that says how many points were left out; empty if all are drawn."""
    return "" if num_drawn == num else f", {num_drawn:,} of {num:,} states drawn"


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
