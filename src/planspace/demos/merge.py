"""Joining datasets of the same robot, such as plans that were made on several machines."""

from collections.abc import Sequence
from dataclasses import fields, replace

from planspace.demos.dataset import Demos
from planspace.demos.state_info import StateInfo
from planspace.errors import UsageError
from planspace.storage.arrays import arrays_hash


def merge_demos(parts: Sequence[Demos], labels: Sequence[str] = ()) -> Demos:
    """Join datasets, one after another, and number their demonstrations anew.

    Search trees are kept if all parts have them. Splits that the sources named are not kept.

    Args:
        parts: two datasets or more with the same states, controls and model.
        labels: what messages call them.

    Raises:
        UsageError: there are fewer than two, one has other states or another model, or two demonstrations are
            equal.
    """
    labels = labels or [f"dataset {i + 1}" for i in range(len(parts))]
    if len(parts) < 2:
        raise UsageError("merging needs two datasets or more.")
    first, seen, episodes = parts[0], {}, []
    with_trees = all(part.trees for part in parts)
    for part, label in zip(parts, labels, strict=True):
        if part.info != first.info:
            raise UsageError(
                f"{label} and {labels[0]} differ in their {_difference(part.info, first.info)}: merge "
                "datasets of the same robot."
            )
        for i in range(len(part)):
            episode = part.episode(i)
            name = f"demonstration {i} of {label}"
            key = arrays_hash({"states": episode.states, "controls": episode.controls})
            if key in seen:
                raise UsageError(
                    f"{name} equals {seen[key]}: were both made with the same seed? Leave one dataset "
                    "out, or plan it again with another --seed."
                )
            seen[key] = name
            tree = episode.tree if with_trees else None
            episodes.append(replace(episode, index=len(episodes), tree=tree))
    return Demos.from_episodes(first.info, episodes)


def _difference(one: StateInfo, other: StateInfo) -> str:
    """The first field in which they differ."""
    words = {"source": "models", "num_controls": "numbers of controls"}
    name = next(field.name for field in fields(one) if getattr(one, field.name) != getattr(other, field.name))
    return words.get(name, name.replace("_", " "))
