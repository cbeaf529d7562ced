"""Training, validation and test demonstrations that the source of a dataset or a file names."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from planspace.errors import PlanspaceError, UsageError, quoted, unknown
from planspace.storage.checks import explain_read

NAMES = {
    "train": ("train", "training"),
    "validation": ("validation", "valid", "val", "dev"),
    "test": ("test", "testing", "holdout"),
}
"""The splits of a dataset, and how sources call them."""
FROM_SOURCE = "source"
"""The value of `--split` for the splits that the source itself names."""
HELD_OUT = 0.1
"""Fraction of the training demonstrations that becomes a split that is not named."""
Splits = Mapping[str, Sequence[int]]
"""Numbers of the demonstrations in each split."""


def read_split_file(file: Path) -> Splits:
    """Read a JSON file such as `{"train": [0, 1, 2], "test": [3]}`.

    Raises:
        PlanspaceError: it cannot be read, or is not an object with lists of numbers.
    """
    with explain_read(file):
        text = file.read_text(encoding="utf-8")
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PlanspaceError(f"{file} is not valid JSON ({error}).") from error
    if not _is_splits(found):
        raise PlanspaceError(
            f'{file} must be an object with lists of numbers of demonstrations, such as {{"train": [0, 1], '
            f'"test": [2]}}; got {quoted(found)}.'
        )
    return found


def chosen_splits(option: str, named: Splits, columns: Sequence[str]) -> Splits:
    """The splits that `--split` asks for; empty if it is not given.

    Args:
        option: the value of the option.
        named: the splits that the source names, or that the chosen column contains.
        columns: the columns of the source.

    Raises:
        UsageError: the source has no such splits.
        PlanspaceError: the file cannot be read.
    """
    if not option:
        return {}
    if option.endswith(".json"):
        return read_split_file(Path(option))
    if option != FROM_SOURCE and option not in columns:
        raise UsageError(f"--split: {unknown('column', option, [*columns, FROM_SOURCE])} Or give FILE.json.")
    if not named:
        raise UsageError("--split source: the source names no splits; give --split FILE.json.")
    return named


def are_complete(named: Splits) -> bool:
    """Whether splits name training demonstrations and others."""
    kinds = {name for name, synonyms in NAMES.items() for key in named if key.lower() in synonyms}
    return "train" in kinds and len(kinds) > 1


def place_splits(named: Splits, indices: Int[np.ndarray, " demo"]) -> dict[str, list[int]]:
    """The places in a dataset of the demonstrations in each split.

    Args:
        named: numbers of the demonstrations by the name of the split. Other names than those in `NAMES` are
            not used.
        indices: the number of each demonstration of the dataset.

    Raises:
        UsageError: no name is known, a demonstration is in two splits, or none is left for training.
    """
    placed: dict[str, list[int]] = {}
    for name, synonyms in NAMES.items():
        numbers = {int(n) for key, found in named.items() if key.lower() in synonyms for n in found}
        if missing := sorted(numbers - set(indices.tolist())):
            raise UsageError(
                f"--split: the {name} demonstrations include number {missing[0]}, which was not imported; "
                f"the numbers are {indices.min()} to {indices.max()}."
            )
        if places := np.flatnonzero(np.isin(indices, list(numbers))).tolist():
            placed[name] = places
    if "train" not in placed or len(placed) < 2:
        raise UsageError(
            f"--split needs training demonstrations and others; the splits are {', '.join(named) or 'none'}."
        )
    every = [place for places in placed.values() for place in places]
    if len(set(every)) < len(every):
        raise UsageError("--split: a demonstration is in two splits; each belongs to one.")
    return placed


def complete_splits(placed: Splits, seed: int) -> dict[str, Int[np.ndarray, " demo"]]:
    """All three splits. One that is not named is drawn from the training demonstrations.

    Args:
        placed: the places of the demonstrations in each named split.
        seed: seed of the drawing.
    """
    splits = {name: np.sort(np.array(places, dtype=int)) for name, places in placed.items()}
    for name in NAMES:
        if name not in splits:
            order = np.random.default_rng(np.random.SeedSequence([seed])).permutation(splits["train"])
            num = max(1, round(HELD_OUT * len(order)))
            if num >= len(order):
                raise PlanspaceError(f"there are too few training demonstrations to draw a {name} split.")
            splits[name], splits["train"] = np.sort(order[:num]), np.sort(order[num:])
    return {name: splits[name] for name in NAMES}


def check_splits(found: Any, count: int) -> Splits:
    """Check the splits that a manifest contains.

    Raises:
        ValueError: they are malformed.
    """
    if not _is_splits(found) or not all(
        name in NAMES and all(0 <= place < count for place in places) for name, places in found.items()
    ):
        raise ValueError("its splits are malformed")
    return found


def _is_splits(found: Any) -> bool:
    return isinstance(found, dict) and all(
        isinstance(places, list) and places and all(type(place) is int for place in places)
        for places in found.values()
    )
