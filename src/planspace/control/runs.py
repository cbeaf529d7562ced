"""Controlling many episodes in a run folder that an interrupted command continues.

DIR/config.json    the settings
DIR/episodes/      every episode, a dataset
DIR/demos/         those that ended at the goal, until they arrived: demonstrations to learn from
DIR/log.jsonl      one row an episode: return, success, wall times
"""

import json
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from planspace.control.config import ControlConfig
from planspace.control.episodes import ControlledEpisode
from planspace.control.plant import Plant
from planspace.control.workers import Setup, control_all
from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.folder import DemoFolder
from planspace.demos.manifest import DatasetSettings
from planspace.demos.state_info import StateInfo
from planspace.embed.embedding import Embedding
from planspace.embed.pixels.encoder import ImageEncoder
from planspace.errors import UsageError, check_setting
from planspace.progress import progress
from planspace.seams import plain_settings
from planspace.storage.arrays import arrays_hash
from planspace.storage.checks import reject_malformed
from planspace.storage.files import read_bytes
from planspace.storage.provenance import Provenance
from planspace.storage.rows import append_rows, is_row, read_rows
from planspace.storage.runs import lock_folder, open_run
from planspace.tasks.task_hash import with_todays_hash

EPISODES, DEMOS, LOG = "episodes", "demos", "log.jsonl"


@dataclass(frozen=True)
class ControlSummary:
    """What the episodes of a run amount to."""

    success: float
    """Fraction of episodes that were at the goal for the whole last second."""
    return_mean: float
    """Mean return of the task."""
    return_worst: float
    """Smallest return."""
    horizon_s: float
    """How far the controller looked ahead [s]."""
    samples: int
    """Candidates in each round."""
    real_time: float
    """Fraction of control steps that were computed within a control step, on one core."""
    regulated: float
    """Fraction of control steps in which the regulator at the goal acted."""
    followed: float
    """Fraction of control steps that followed a plan."""
    episodes: int
    """Number of episodes."""


def control_into(  # noqa: PLR0913
    plant: Plant,
    embedding: Embedding | None,
    config: ControlConfig,
    out: Path,
    *,
    num: int,
    seed: int,
    episode_s: float | None = None,
    workers: int | None = None,
    label: str = "control",
    encoder: ImageEncoder | None = None,
    plans: Demos | None = None,
    starts: Float[np.ndarray, "episode state"] | None = None,
) -> ControlSummary:
    """Control episodes into a run folder; those that it holds are kept.

    Episode i depends on the plant, the embedding, the settings, the seed and i only, so an interrupted
    command ends with the same content as one that was not interrupted.

    Args:
        plant: what is controlled.
        embedding: computes z; needed for the cost `z`.
        config: how the controller looks ahead.
        out: the run folder.
        num: number of episodes that the folder will hold.
        seed: seed of starts, goals and samples.
        episode_s: length of an episode [s]; by default the task's.
        workers: number of processes; by default one for each CPU, 0 for none.
        label: what the progress bar says.
        encoder: estimates the state from pictures; None shows the controller the true state.
        plans: what the setting `follow_s` follows; otherwise unused.
        starts: the start of each episode, at least `num` of them; by default the task draws them.

    Returns:
        What all episodes amount to.

    Raises:
        UsageError: plant, embedding, settings, plans and starts do not fit together.
        PlanspaceError: the folder cannot be written or was made with other settings.
    """
    plant = plant.repeating(config.action_repeat)
    if episode_s is not None:
        wanted = f"finite and at least a control step of {plant.control_step:g} s"
        check_setting("episode_s", episode_s, plant.control_step <= episode_s < math.inf, wanted)
    steps = plant.task.horizon if episode_s is None else round(episode_s / plant.control_step)
    info = StateInfo.of_model(
        plant.model,
        plant.space,
        problem=plant.problem.name,
        joints=plant.problem.joints,
        source=plant.problem.source,
    )
    if starts is not None and (len(starts) < num or starts.shape[1:] != (plant.space.size,)):
        raise UsageError(
            f"{num} episodes need as many starts of {plant.space.size} numbers, got an array of shape "
            f"{starts.shape}."
        )
    setup = Setup(plant, embedding, config, encoder, plans if config.follow_s else None)
    setup.check()
    with lock_folder(out):
        settings = _settings(setup, seed, steps)
        if starts is not None:
            settings["starts"] = arrays_hash({"starts": starts})
        open_run(out, settings, update=partial(with_todays_hash, task=plant.task))
        source = DatasetSettings(problem=plant.problem.hash, seed=seed)
        whole, demos = (DemoFolder(out / name, info, source) for name in (EPISODES, DEMOS))
        logged = _logged(out)
        remaining = [i for i in range(num) if i >= whole.next_index or i not in logged]
        if remaining:
            run = control_all(setup, seed, remaining, steps, workers, starts)
            with closing(run) as episodes:
                _extend(out, logged, whole, demos, _shown(label, remaining, num, episodes))
        return summarise(out, config)


def _logged(out: Path) -> set[int]:
    """Numbers of the episodes whose rows the log of a run folder has; a repaired log can lack some."""
    if not (out / LOG).exists():
        return set()
    return {json.loads(line)["episode"] for line in read_bytes(out / LOG).splitlines() if is_row(line)}


def _settings(setup: Setup, seed: int, steps: int) -> dict[str, Any]:
    """The content of `config.json`; earlier versions recorded neither pictures nor plans."""
    plant, embedding = setup.plant, setup.embedding
    used = {"pixels": setup.encoder, "plans": setup.plans}
    return {
        "task": plant.task.name,
        "task_sha256": plant.task.hash,
        "problem": plant.problem.hash,
        "embedding": None if embedding is None else embedding.hash,
        "seed": seed,
        "episode_steps": steps,
        **plain_settings(setup.config),
        "versions": Provenance.current("mujoco").plain(),
        **{name: given.hash for name, given in used.items() if given is not None},
    }


def summarise(out: Path, config: ControlConfig) -> ControlSummary:
    """Sum up the episodes that a run folder holds.

    Raises:
        PlanspaceError: the log is missing or damaged.
    """
    with reject_malformed(out / LOG):
        rows = sorted(read_rows(out / LOG), key=lambda row: row["episode"])
        returns = [float(row["return"]) for row in rows]
        mean = {
            key: float(np.mean([row[key] for row in rows])) for key in ("success", "real_time", "regulated")
        }
        # runs of earlier versions followed no plans
        followed = float(np.mean([row.get("followed", 0.0) for row in rows]))
    return ControlSummary(
        success=mean["success"],
        return_mean=float(np.mean(returns)),
        return_worst=min(returns),
        horizon_s=config.horizon_s,
        samples=config.samples,
        real_time=mean["real_time"],
        regulated=mean["regulated"],
        followed=followed,
        episodes=len(rows),
    )


def successes(out: Path) -> list[bool]:
    """Whether each episode of a run folder succeeded, in the order of the episodes.

    Raises:
        PlanspaceError: the log is missing or damaged.
    """
    with reject_malformed(out / LOG):
        return [bool(row["success"]) for row in sorted(read_rows(out / LOG), key=lambda row: row["episode"])]


def _extend(
    out: Path,
    logged: set[int],
    whole: DemoFolder,
    demos: DemoFolder,
    episodes: Iterable[tuple[int, ControlledEpisode]],
) -> None:
    """Save each episode as it ends: its row, then its demonstration, then the episode, which counts it."""
    for i, episode in episodes:
        if i not in logged:
            append_rows(out / LOG, [_row(i, episode)], key="episode")
        if demos.next_index <= i:  # otherwise a kill came between the two datasets
            arrived = _arrived(episode, i)
            demos.append([] if arrived is None else [arrived], i + 1)
        if whole.next_index <= i:  # otherwise only the row was missing
            whole.append([_as_demonstration(episode, i, len(episode.controls))], i + 1)


def _shown(
    label: str, remaining: Sequence[int], num: int, episodes: Iterator[ControlledEpisode]
) -> Iterator[tuple[int, ControlledEpisode]]:
    """Number the episodes, and show the progress towards `num`."""
    held = 0
    with progress(label, num, done=num - len(remaining), unit="episode") as bar:
        for done, (i, episode) in enumerate(zip(remaining, episodes, strict=True), 1):
            yield i, episode
            held += episode.success
            bar.set_postfix_str(f"{held} of {done} stay at the goal", refresh=False)
            bar.update()


def _as_demonstration(episode: ControlledEpisode, index: int, num_steps: int) -> Episode:
    """The first steps of an episode as a demonstration."""
    return Episode(
        states=episode.states[: num_steps + 1],
        controls=episode.controls[:num_steps],
        times=episode.step * np.arange(num_steps + 1),
        goal=episode.goal,
        success=episode.success,
        index=index,
        seed=0,
        cost=episode.step * num_steps,
    )


def _arrived(episode: ControlledEpisode, index: int) -> Episode | None:
    """An episode that succeeded, until it arrived at its goal; None for others."""
    if not episode.success or not episode.arrival:
        return None
    return _as_demonstration(episode, index, episode.arrival)


def _row(index: int, episode: ControlledEpisode) -> dict[str, Any]:
    in_time = episode.seconds <= episode.step
    return {
        "episode": index,
        "time": time.time(),
        "return": float(episode.rewards.sum()),
        "success": episode.success,
        "arrival": episode.arrival,
        "regulated": float(episode.regulated.mean()) if len(in_time) else 0.0,
        "followed": float(episode.followed.mean()) if len(in_time) else 0.0,
        "real_time": float(in_time.mean()) if len(in_time) else 0.0,
        "step_ms": float(1e3 * np.median(episode.seconds)) if len(in_time) else 0.0,
    }
