"""Shards of a study: parts that run on separate machines, each in a folder of its own, and are then merged.

    DIR/STUDY-BUDGET-shard-I-of-N/             a folder of studies with the units of shard I
    DIR/STUDY-BUDGET-shard-I-of-N/shard.json   the shard's number, and the settings of the study

A shard has some of the study's policies, and makes the demonstrations and embeddings that they need. A unit
that several shards make must have the same result in each.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from planspace.errors import PlanspaceError, UsageError
from planspace.storage.checks import CONFIG, reject_malformed
from planspace.storage.files import make_folder, read_bytes, write_bytes
from planspace.storage.json_files import json_hash, read_description, read_json, write_sealed
from planspace.storage.runs import lock_folder
from planspace.storage.settings import list_differences
from planspace.study.cluster import files_in, write_files
from planspace.study.design import Study, all_needs
from planspace.study.execute import VERSIONS, folder_of, has_folder, is_done, read_result, result_file
from planspace.study.run import open_results
from planspace.study.summary import folder_of_study
from planspace.study.unit import Unit

FILE, KIND, SCHEMA = "shard.json", "shard of a study", 1
BISECTIONS = 40
"""Steps of the search for the shortest time of the slowest shard."""


@dataclass(frozen=True)
class Shard:
    """One of several shards."""

    index: int
    """From 1 to `count`."""
    count: int

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Read `I/N`.

        Raises:
            UsageError: the text is not `I/N`, or I is not between 1 and N.
        """
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text, re.ASCII)
        if found is None or not 1 <= int(found[1]) <= int(found[2]):
            raise UsageError(f"`--shard` must be I/N with I from 1 to N, such as 2/3, got {text!r}.")
        return cls(int(found[1]), int(found[2]))

    def __str__(self) -> str:
        """Format as `shard 2 of 3`."""
        return f"shard {self.index} of {self.count}"

    def folder(self, study: Study, out: Path) -> Path:
        """The folder of this shard of a study."""
        return out / f"{folder_of_study(study, out).name}-shard-{self.index}-of-{self.count}"


# --- running --------------------------------------------------------------------------------------------


def divide(study: Study, count: int) -> list[Study]:
    """Divide a study into shards so that the slowest shard takes as short as possible.

    The division depends only on the study and the number of shards. Policies that need the same
    demonstrations and embeddings are neighbours in a list, which is cut into shards. The time of a shard
    includes the demonstrations and embeddings that it makes.

    Args:
        study: the study.
        count: number of shards.

    Returns:
        For each shard, the study with only the shard's policies. No shard is empty.

    Raises:
        UsageError: the study has fewer units of policies than there are shards.
    """
    units = {unit.name: unit for arm in study.arms for unit in arm.units}
    if count > len(units):
        raise UsageError(
            f"study {study.name} cannot be divided into {count} shards: it has only {len(units)} units of "
            "policies."
        )
    needs = {name: tuple(need.name for need in all_needs([unit])) for name, unit in units.items()}
    names = sorted(units, key=lambda name: (not needs[name], needs[name], name))  # without needs: at the end
    pieces = [{name, *needs[name]} for name in names]
    costs = {unit.name: unit.cost for unit in study.units}
    low, high = max(_cost(piece, costs) for piece in pieces), _cost(set(costs), costs)
    shards = _cut(pieces, costs, count, high)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        tried = _cut(pieces, costs, count, middle)
        if len(tried) <= count:
            shards, high = tried, middle
        else:
            low = middle
    return [_part(study, shard) for shard in shards]


def _cut(pieces: Sequence[set[str]], costs: Mapping[str, float], count: int, limit: float) -> list[set[str]]:
    """Join neighbouring sets of units into at least `count` shards of at most `limit` seconds each."""
    shards: list[set[str]] = [set()]
    for i, piece in enumerate(pieces):
        is_full = _cost(shards[-1] | piece, costs) > limit
        if shards[-1] and (is_full or len(pieces) - i <= count - len(shards)):  # leave no shard empty
            shards.append(set())
        shards[-1] |= piece
    return shards


def _cost(names: set[str], costs: Mapping[str, float]) -> float:
    return sum(costs[name] for name in sorted(names))  # in order, so that the sum is the same everywhere


def _part(study: Study, names: set[str]) -> Study:
    """The study with only these units."""
    units = [tuple(unit for unit in arm.units if unit.name in names) for arm in study.arms]
    arms = (replace(arm, units=own) for arm, own in zip(study.arms, units, strict=True) if own)
    return replace(study, arms=tuple(arms))


def open_shard(study: Study, shard: Shard, out: Path) -> Path:
    """Make or open the folder of a shard.

    Args:
        study: the whole study.
        shard: the shard.
        out: the folder of the studies.

    Returns:
        The shard's folder. It is the folder of studies in which `run_study` runs the shard's part.

    Raises:
        PlanspaceError: the folder was made with other settings or versions, or is in use.
    """
    folder = shard.folder(study, out)
    with lock_folder(folder):
        open_results(folder)
        if (folder / FILE).exists():
            _check_settings(folder, study)
        else:
            about = {"shard": f"{shard.index}/{shard.count}", "units": _hash(study), **_settings(study)}
            write_sealed(folder / FILE, {"schema": SCHEMA, "kind": KIND, **about})
    return folder


def _settings(study: Study) -> dict[str, Any]:
    return {
        "study": study.name,
        "task": study.task,
        "budget": study.budget,
        "seeds": study.seeds or "default",
        "only": list(study.parts),
    }


def _hash(study: Study) -> str:
    """The hash of the names of all units."""
    return json_hash({"units": sorted(unit.name for unit in study.units)})


def _check_settings(folder: Path, study: Study) -> Shard:
    """Check that a shard was made for the same units and with the same versions, and return its number."""
    file = folder / FILE
    if not file.exists():
        raise PlanspaceError(
            f"{folder} is not a shard of a study: it has no {FILE}. Give the folders that --shard I/N made."
        )
    about = read_description(file, kind=KIND, schema=SCHEMA)
    now = _settings(study)
    with reject_malformed(file):
        shard, units, before = Shard.parse(about["shard"]), about["units"], {key: about[key] for key in now}
    changed = list(list_differences(read_json(folder / CONFIG)["versions"], VERSIONS, "version of "))
    if changed or units != _hash(study):
        changed += list_differences(before, now)
        content = f"the content of the task {study.task} differs"  # the only setting that has no name
        raise PlanspaceError(
            f"{folder} ({shard}) was made with other settings: {'; '.join(changed) or content}. "
            "Give the same settings, or run the shard again in another --out."
        )
    return shard


# --- merging --------------------------------------------------------------------------------------------


def merge_shards(study: Study, folders: Sequence[Path], out: Path) -> None:
    """Copy the results of all shards of a study into one folder, as if the study had been run there.

    Args:
        study: the whole study.
        folders: the shards' folders, in any order.
        out: the folder of the studies.

    Raises:
        PlanspaceError: a shard was made with other settings or versions, is given twice, is missing or is
            not finished; or two shards have different results of the same unit.
    """
    shards = _read_shards(study, folders)
    sources: dict[str, Path] = {}
    for (shard, folder), part in zip(shards.items(), divide(study, len(shards)), strict=True):
        units = part.units
        missing = sum(not is_done(unit, folder) for unit in units)
        if missing:
            raise PlanspaceError(
                f"{shard} is not finished: {folder} lacks {missing} of {len(units)} units. Run it again with "
                f"--shard {shard.index}/{shard.count}, which continues it."
            )
        for unit in units:
            _check_same(unit, sources.setdefault(unit.name, folder), folder)
    with lock_folder(out):
        open_results(out)
        make_folder(out / "units")
        for unit in study.units:
            _copy(unit, sources[unit.name], out)


def _read_shards(study: Study, folders: Sequence[Path]) -> dict[Shard, Path]:
    """The shards and their folders, in order; an error if they do not make up the study."""
    shards: dict[Shard, Path] = {}
    for folder in folders:
        shard = _check_settings(folder, study)
        if shard in shards:
            raise PlanspaceError(f"{shard} is given twice: {shards[shard]} and {folder}.")
        first = next(iter(shards), shard)
        if shard.count != first.count:
            raise PlanspaceError(
                f"the shards are of different divisions: {shards[first]} is {first}, {folder} is {shard}."
            )
        shards[shard] = folder
    count = next(iter(shards)).count
    missing = [str(i) for i in range(1, count + 1) if Shard(i, count) not in shards]
    if missing:
        several = f"shards {', '.join(missing)} of {count} are" if len(missing) > 1 else ""
        raise PlanspaceError(
            f"{several or f'shard {missing[0]} of {count} is'} missing. Give the folders of all shards."
        )
    return dict(sorted(shards.items(), key=lambda item: item[0].index))


def _check_same(unit: Unit, folder: Path, other: Path) -> None:
    """Check that two folders have the same result of a unit, except for the time."""
    if folder != other and read_result(unit, folder).found != read_result(unit, other).found:
        raise PlanspaceError(
            f"{unit.name} has different results in {folder} and {other}, because their machines or libraries "
            "round differently. Run these shards again on equal machines, in another --out."
        )


def _copy(unit: Unit, source: Path, out: Path) -> None:
    """Copy a unit's folder, if there is one, and its result."""
    if is_done(unit, out):
        _check_same(unit, source, out)
        return
    if has_folder(unit, source):
        write_files(folder_of(unit, out), files_in(folder_of(unit, source)))
    write_bytes(result_file(unit, out), read_bytes(result_file(unit, source)))
