"""From the demonstrations of a source to those of a dataset: cleaned, declared, continuous and evenly spaced.

Each stage reads the demonstrations one at a time and writes a temporary dataset, so memory does not grow with
the source.
"""

import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planspace.demos.clean import Cleaning, longest_step
from planspace.demos.dataset import Demos
from planspace.demos.declare import Meaning, declare_states
from planspace.demos.episode import Episode, Origin, check_episode
from planspace.demos.folder import DemoFolder
from planspace.demos.import_table import import_table
from planspace.demos.limits import limit_notices
from planspace.demos.recording import Imported, ImportOptions
from planspace.demos.resample import (
    common_step,
    has_step,
    resample,
    thin,
    thinning_step,
    uneven_steps,
    with_continuous_angles,
)
from planspace.demos.splits import are_complete, chosen_splits, place_splits
from planspace.demos.state_info import StateInfo
from planspace.demos.stored import StoredDemos
from planspace.demos.survey import Survey
from planspace.demos.suspects import Suspects
from planspace.demos.velocity_check import VelocityCheck
from planspace.errors import PlanspaceError
from planspace.progress import progress_over

RECORDED, DECLARED, RESAMPLED = "recorded", "declared", "even"
"""The temporary datasets in the staging folder."""


@dataclass(frozen=True)
class Prepared:
    """The demonstrations of a dataset before they are stored."""

    demos: StoredDemos
    notices: tuple[str, ...]
    """What was assumed and changed, one line each."""
    splits: dict[str, list[int]]
    """The demonstrations in each split that the user chose; empty to draw them at random."""


def prepare(
    imported: Imported, source: str, options: ImportOptions, staging: Path, show: Callable[[str], None]
) -> Prepared:
    """Check, clean and align the demonstrations of a source.

    Args:
        imported: the source.
        source: its name, for messages.
        options: how to import it.
        staging: a folder for temporary datasets.
        show: called with the table of columns, before demonstrations are changed.

    Raises:
        UsageError: an option does not fit the source.
        PlanspaceError: a demonstration is damaged or has gaps; the message names its place.
    """
    if not imported.info.names:
        raise PlanspaceError(f"{source}: its states are empty.")
    if imported.exported and options.rate is None and options.gaps == "refuse":
        options = replace(options, as_recorded=True)
    cleaning, survey, origins = Cleaning(), Survey(len(imported.info.names), imported.info.num_controls), []
    episodes = cleaning.clean_rows(_checked(imported, source), as_recorded=options.as_recorded)
    episodes = progress_over(_surveyed(episodes, survey, origins), "read", unit="demo")
    recorded = _stage(staging / RECORDED, imported.info, episodes)
    if recorded is None:
        why = "; ".join(cleaning.notices(options.gaps)) or "there are no demonstrations"
        raise PlanspaceError(f"{source}: {why}.")
    columns = [use.name for use in imported.uses]
    meaning = declare_states(
        imported.info,
        survey,
        options,
        columns,
        recorded_units=imported.units,
        guess=not imported.exported,
    )
    show(import_table(imported, meaning, survey, len(recorded)))
    suspects = Suspects(imported.info.names, survey, meaning.rotations)

    def located() -> Iterator[Episode]:
        pairs = zip(recorded.episodes(), origins, strict=True)
        return (replace(episode, origin=origin) for episode, origin in pairs)

    def declared() -> Iterator[Episode]:
        episodes = progress_over(located(), "compare", unit="demo", total=len(recorded))
        return map(meaning.apply, episodes)

    doubts = [*VelocityCheck(meaning.info).notices(declared), *limit_notices(meaning, survey)]
    watched = suspects.watch(located())
    demos = _declare(recorded, watched, meaning, imported.keep_angles, cleaning, options, staging)
    notices = [*imported.notices, *cleaning.notices(options.gaps), *suspects.notices(), *doubts]
    demos = _align(demos, options, staging, notices)
    named = chosen_splits(options.split, imported.splits, columns)
    splits = place_splits(named, _indices(demos)) if named else {}
    if not named and are_complete(imported.splits):
        known = ", ".join(f"{name} ({len(numbers)})" for name, numbers in imported.splits.items())
        notices.append(f"the source names the splits {known}: --split source uses them.")
    return Prepared(demos, tuple(notices), splits)


def _indices(demos: StoredDemos) -> np.ndarray:
    """The number of each demonstration in its source."""
    return np.concatenate([part.indices for part in demos.shards()])


def _align(demos: StoredDemos, options: ImportOptions, staging: Path, notices: list[str]) -> StoredDemos:
    """Resample or thin demonstrations to one time step, if they have different ones."""
    step = None if options.as_recorded else _wanted_step(demos, options.rate)
    if step is None:
        return demos
    count = sum(not has_step(episode, step) for episode in demos.episodes())
    notices.append(f"resampled {count} of {len(demos)} demonstrations to a step of {step:.6g} s")
    align = resample if options.rate is None else thin
    aligned = (align(episode, demos.info, step) for episode in demos.episodes())
    even = _stage(
        staging / RESAMPLED, demos.info, progress_over(aligned, "resample", unit="demo", total=len(demos))
    )
    assert even is not None
    remove(demos.path)
    return even


def _wanted_step(demos: StoredDemos, rate: float | None) -> float | None:
    """The time step to resample to; None if the recorded steps are even."""

    def steps() -> Iterator[np.ndarray]:
        return map(_steps, demos.shards())

    if rate is None:
        return common_step(steps, demos.info)
    return thinning_step(uneven_steps(steps), float(next(steps())[0]), rate)


def _checked(imported: Imported, source: str) -> Iterator[Episode]:
    for episode in imported.episodes:
        try:
            check_episode(imported.info, episode)
        except PlanspaceError as error:
            raise PlanspaceError(f"{source}: {error}") from error
        yield episode


def _surveyed(episodes: Iterable[Episode], survey: Survey, origins: list[Origin | None]) -> Iterator[Episode]:
    """Pass on demonstrations, and keep their statistics and where they are from."""
    for episode in episodes:
        survey.update(episode)
        origins.append(episode.origin)
        yield episode


def _stage(path: Path, info: StateInfo, episodes: Iterable[Episode]) -> StoredDemos | None:
    """Write a temporary dataset; None if there are no demonstrations."""
    folder = DemoFolder(path, info, {})
    folder.extend(episodes)
    return StoredDemos(path) if folder.num_episodes else None


def _declare(
    demos: StoredDemos,
    episodes: Iterable[Episode],
    meaning: Meaning,
    keep_windings: bool,
    cleaning: Cleaning,
    options: ImportOptions,
    staging: Path,
) -> StoredDemos:
    """Give the states their meaning, cut demonstrations at gaps, and make angles continuous."""
    steps = None if options.as_recorded else uneven_steps(lambda: map(_steps, demos.shards()))
    longest = np.inf if steps is None else longest_step(steps)
    if steps is not None and steps.max() <= longest:
        longest = np.inf

    def declared() -> Iterator[Episode]:
        applied = map(meaning.apply, episodes)
        for episode in cleaning.split_gaps(applied, longest, options.gaps):
            if options.as_recorded:
                yield episode
            else:
                yield with_continuous_angles(episode, meaning.info, keep_windings=keep_windings)

    angles = meaning.info.circular_columns or meaning.info.quaternion_columns
    if not meaning.changes_numbers and meaning.info == demos.info and not angles and longest == np.inf:
        for _ in episodes:  # they are watched
            pass
        return demos
    staged = _stage(staging / DECLARED, meaning.info, declared())
    if options.gaps == "refuse":
        cleaning.check_gaps(longest)
    if staged is None:
        raise PlanspaceError(f"after cutting at gaps, {'; '.join(cleaning.notices(options.gaps))}.")
    remove(demos.path)
    return staged


def remove(folder: Path) -> None:
    """Remove a temporary folder; of a link, remove the link only."""
    if folder.is_symlink():
        folder.unlink()
    else:
        shutil.rmtree(folder, ignore_errors=True)


def _steps(demos: Demos) -> np.ndarray:
    """Duration of each step [s]."""
    within = np.ones(len(demos.times) - 1, dtype=bool)
    within[demos.offsets[1:-1] - 1] = False
    return np.diff(demos.times)[within]
