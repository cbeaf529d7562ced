"""Everything `planspace measure` says of an embedding: geometry by split and beside baselines, and checks."""

import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats
from jaxtyping import Float, Int

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding, check_numbers
from planspace.embed.geometry import (
    bootstrap_intervals,
    measure_constant,
    measure_raw_state,
    summarise,
    tabulate,
)
from planspace.errors import PlanspaceError
from planspace.progress import progress
from planspace.storage.checks import MAX_BYTES, check_file

TRUTH_KEYS = ("states", "time", "goal")
SPLITS = ("train", "validation", "test")


def assess(embedding: Embedding, demos: Demos, truth: Path | None = None) -> dict[str, Any]:
    """Measures an embedding on demonstrations in every way there is.

    Args:
        embedding: what to measure.
        demos: the demonstrations; if it was trained on them, each split is measured by itself.
        truth: an .npz with `states` [n, state], the least `time` [n] from each to the goal, in seconds, and
            `goal` [state]; the columns are those of the demonstrations.

    Returns:
        For each split, each metric of `Geometry` of z with its 95 % interval over demonstrations, of the raw
        state (standardised by the training split, or by these demonstrations) and of a constant z; and
        `checks`: see there.

    Raises:
        PlanspaceError: the demonstrations lack a state the embedding reads, numbers are too large to be
            computed with, or `truth` or the embedding's own split does not fit.
    """
    used = demos.select(embedding.inputs.names)
    check_numbers("the demonstrations' states", used.states)
    with np.errstate(over="ignore", invalid="ignore"):  # whether all is finite is seen here
        z = embedding.encode(used.states)
        check_numbers("z of these states, or the states decoded from it,", z, embedding.decode(z))
    splits = split_of(embedding, demos)
    reference = splits.get("train", np.arange(len(demos)))
    found = {"splits": {}, "checks": checks(embedding, used, truth, demos.info.names)}
    with progress("measure", len(splits), unit="split") as bar:
        for name, part in splits.items():
            found["splits"][name] = _beside(embedding, used, part, reference)
            bar.update()
    return found


def split_of(embedding: Embedding, demos: Demos) -> dict[str, np.ndarray]:
    """The splits it was trained with, if these are its demonstrations; otherwise `all`.

    Raises:
        PlanspaceError: they are, but what it says of the splits cannot be.
    """
    about = embedding.about
    if "split" not in about or about.get("settings", {}).get("demos") != demos.hash:
        return {"all": np.arange(len(demos))}
    try:
        splits = {name: np.array(about["split"][name], dtype=int).ravel() for name in SPLITS}
    except (KeyError, TypeError, ValueError, OverflowError):
        splits = {name: np.empty(0, dtype=int) for name in SPLITS}
    dealt = np.sort(np.concatenate(list(splits.values())))
    if not np.array_equal(dealt, np.arange(len(demos))) or not all(map(len, splits.values())):
        raise PlanspaceError(
            f"the embedding says it was trained on these {len(demos)} demonstrations, but does not deal each "
            f"of them to one of {', '.join(SPLITS)}: its file was altered. Train it anew."
        )
    return splits


def checks(
    embedding: Embedding, demos: Demos, truth: Path | None, columns: tuple[str, ...]
) -> dict[str, float]:
    """What geometry along demonstrations does not see.

    Returns:
        `change_by_a_turn`: how far z moves, in its deviation, when an angle on a circle is turned by 2 pi
        (0 is right), at most over all states and angles; `outside_support`: share of the states where z is a
        guess; `true_time_correlation`: Spearman of |z - z_goal| with the least time to the goal. What does
        not apply is left out.
    """
    found = {}
    z = embedding.encode(demos.states)
    circles = embedding.inputs.circular_columns
    if circles:
        turn = 2 * np.pi * np.eye(demos.states.shape[1])
        moved = [np.linalg.norm(embedding.encode(demos.states + turn[c]) - z, axis=1).max() for c in circles]
        found["change_by_a_turn"] = float(max(moved) / np.linalg.norm(z.std(axis=0)))
    if embedding.support is not None:
        found["outside_support"] = float(embedding.outside_support(demos.states).mean())
    if truth is not None:
        states, time, goal = load_truth(truth, columns)
        read = list(embedding.columns_of(columns))
        found["true_time_correlation"] = true_time_correlation(embedding, states[:, read], time, goal[read])
    return found


def true_time_correlation(
    embedding: Embedding,
    states: Float[np.ndarray, "row state"],
    time: Float[np.ndarray, " row"],
    goal: Float[np.ndarray, " state"],
) -> float:
    """Spearman correlation of |z - z_goal| with the least time to the goal."""
    return float(scipy.stats.spearmanr(embedding.distance(states, goal), time).statistic)


def load_truth(path: Path, columns: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, least times to the goal [s], and the goal, from an .npz.

    Raises:
        PlanspaceError: it cannot be read, lacks an array, or sizes do not fit.
    """
    check_file(path, most=MAX_BYTES, may_be_link=True)
    try:
        with open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = {key: np.asarray(file[key], dtype=float) for key in TRUTH_KEYS}
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile) as error:
        raise PlanspaceError(
            f"{path} is no .npz with `states`, `time` and `goal`: {' '.join(str(error).split())}"
        ) from None
    states, time, goal = arrays["states"], arrays["time"], arrays["goal"]
    n = len(columns)
    if time.ndim != 1 or states.shape != (len(time), n) or goal.shape != (n,):
        raise PlanspaceError(
            f"{path}: `states` must be [n, {n}] ({', '.join(columns)}), `time` [n] and `goal` [{n}]; got "
            f"{states.shape}, {time.shape} and {goal.shape}."
        )
    if not all(np.isfinite(a).all() for a in arrays.values()):
        raise PlanspaceError(f"{path} holds a number that is not finite.")
    if len(np.unique(time)) < 2:
        raise PlanspaceError(f"{path}: `time` needs two different times at least, to be correlated with.")
    return states, time, goal


def _beside(
    embedding: Embedding, demos: Demos, part: Int[np.ndarray, " demo"], reference: np.ndarray
) -> dict[str, Any]:
    table = tabulate(embedding, demos, part)
    return {
        "embedding": asdict(summarise(table)),
        "intervals": bootstrap_intervals(table),
        "raw_state": asdict(measure_raw_state(demos, part, reference)),
        "constant": asdict(measure_constant(demos, part)),
    }
