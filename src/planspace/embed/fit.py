"""Train an embedding from demonstrations: train several seeds at once, select the best one and save it."""

import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos
from planspace.embed.about import About, ObjectiveSummary, TrainingSettings
from planspace.embed.card import model_card
from planspace.embed.config import PRESETS, FitConfig, TimeHeadConfig, update_saved
from planspace.embed.embedding import Embedding
from planspace.embed.geometry import (
    MIN_STATES,
    Geometry,
    bootstrap_intervals,
    measure,
    measure_constant,
    measure_raw_state,
    paper_path_errors,
    tabulate,
)
from planspace.embed.inputs import Inputs, check_numbers
from planspace.embed.networks import GaussianNetwork, PlanSpaceModel
from planspace.embed.objective import Objective, as_objective, summary_of, title_of
from planspace.embed.principal import principal_map
from planspace.embed.rotations import find_quaternions
from planspace.embed.samples import Samples, make_samples
from planspace.embed.saved_embedding import CARD, DESCRIPTION, LOG, load_embedding
from planspace.embed.steps import check_loss
from planspace.embed.support import Support
from planspace.embed.time_training import fit_time_head
from planspace.embed.training import train
from planspace.errors import PlanspaceError, UsageError
from planspace.progress import progress_shown
from planspace.seams import check_kind, plain_settings
from planspace.storage.files import write_bytes
from planspace.storage.provenance import Provenance
from planspace.storage.rows import append_rows
from planspace.storage.runs import lock_folder, open_run
from planspace.storage.tracking import Tracker, open_tracker

MEASURED = 20
"""How often during training the geometry on the validation split is logged."""
CURVES = (
    "straightness",
    "speed_variation",
    "midpoint_error",
    "time_correlation",
    "effective_rank",
    "decoded_error",
)
"""The metrics that are logged."""


def fit_embedding(  # noqa: PLR0913 - the public call, all but two arguments by keyword
    demos: Demos,
    objective: str | Objective | Callable[..., Any] | None = None,
    *,
    config: FitConfig | None = None,
    out: str | Path | None = None,
    num_seeds: int = 5,
    seed: int = 0,
    split_seed: int | None = None,
    time_head: bool | TimeHeadConfig = False,
    verbose: bool = True,
    tensorboard: bool = False,
) -> Embedding:
    """Train several seeds of an embedding on demonstrations and return the best one.

    The preset `modern` selects by the midpoint error on the validation split among the seeds without a
    collapsed dimension; `paper` by the path error on the training split, as the paper does. The test split is
    used for neither.

    Args:
        demos: the demonstrations.
        objective: what to train on: the name of a shipped objective (see `OBJECTIVES`), an `Objective`, or a
            function `loss(model, sample, *, key)`; by default that of `config`. See
            docs/howto/own-objective.md.
        config: the other settings; by default the preset `modern`.
        out: a folder for the embedding. The same call continues an interrupted training, and returns a
            finished one. By default nothing is saved.
        num_seeds: number of seeds to train.
        seed: the first seed; seeds seed, seed + 1, ... are trained.
        split_seed: seed of the split of the demonstrations; by default `seed`.
        time_head: also train `Embedding.time_to_go`, after the rest, which does not change: True, or its
            settings. Demonstrations with search trees make it better.
        verbose: show a progress bar.
        tensorboard: also write the curves for TensorBoard; needs `out`.

    Raises:
        PlanspaceError: the demonstrations cannot be used, the folder was made with other settings, or a seed
            diverged.
        UsageError: a name is unknown, or the objective does not fit `Objective`.
    """
    check_kind("demos", demos, Demos, ": load them first")
    config = config or PRESETS["modern"]
    config = replace(config, objective=as_objective(config.objective))
    if objective is not None:
        config = config.with_objective(objective)
    if num_seeds < 1 or seed < 0:
        raise UsageError(f"`num_seeds` must be at least 1 and `seed` at least 0, got {num_seeds} and {seed}.")
    if out is None and tensorboard:
        raise UsageError("`tensorboard` needs `out`, a folder for the curves.")
    seeds, split_seed = range(seed, seed + num_seeds), seed if split_seed is None else split_seed
    head = TimeHeadConfig() if time_head is True else time_head or None
    request = _Request(config, seeds, split_seed, head)
    with progress_shown(verbose):
        if out is not None:
            return _fit(demos, Path(out), request, tensorboard)
        with tempfile.TemporaryDirectory() as folder:
            return _fit(demos, Path(folder) / "embedding", request, tensorboard)


def fit_seeds(
    demos: Demos,
    out: Path,
    *,
    config: FitConfig,
    seeds: Sequence[int],
    split_seed: int,
    split: dict[str, np.ndarray] | None = None,
) -> list[Embedding]:
    """Train the given seeds and return the embedding of each, without selecting one.

    Args:
        demos: the demonstrations.
        out: a folder for the checkpoint and the log.
        config: how to train.
        seeds: the seeds; an objective with a closed form gives one embedding for any seeds.
        split_seed: seed of the split of the demonstrations, and of the triplets.
        split: the split; by default it is drawn.

    Raises:
        PlanspaceError: the demonstrations cannot be used, or a seed diverged.
    """
    return _train_seeds(_prepare(demos, config, split_seed, split), out, config, seeds, tensorboard=False)


@dataclass(frozen=True)
class _Request:
    """The arguments of a training, except the demonstrations."""

    config: FitConfig
    seeds: Sequence[int]
    split_seed: int
    time_head: TimeHeadConfig | None


def _fit(demos: Demos, out: Path, request: _Request, tensorboard: bool) -> Embedding:
    prepared = _prepare(demos, request.config, request.split_seed)  # refuses unusable input before writing
    seeds = tuple(request.seeds if prepared.solution is None else request.seeds[:1])
    fit = plain_settings(request.config)
    if request.time_head is not None:
        fit |= {"time_head": plain_settings(request.time_head)}
    settings = TrainingSettings(demos.hash, seeds, request.split_seed, fit=fit)
    with lock_folder(out):
        open_run(
            out, asdict(settings), update=lambda saved: saved | {"fit": update_saved(saved.get("fit", {}))}
        )
        if (out / DESCRIPTION).exists():
            return load_embedding(out)
        return _train_and_save(prepared, out, request, settings, tensorboard)


def _train_and_save(
    prepared: "_Prepared", out: Path, request: _Request, settings: TrainingSettings, tensorboard: bool
) -> Embedding:
    config, seeds, split_seed = request.config, settings.seeds, settings.split_seed
    embeddings = _train_seeds(prepared, out, config, seeds, tensorboard)
    split, used = prepared.split, prepared.demos
    chosen, validation = choose(embeddings, used, split, config)
    support = Support.fit(
        prepared.inputs(prepared.train_states),
        prepared.inputs(used.states[used.rows(split["validation"])]),
        np.random.default_rng(np.random.SeedSequence([split_seed, 2])),
    )
    best = embeddings[chosen]
    if request.time_head is not None:
        head = fit_time_head(best, used, split["train"], request.time_head, seeds[chosen])
        best = replace(best, time_head=head)
    about = About(
        preset=config.preset,
        seed=seeds[chosen],
        settings=settings,
        objective=ObjectiveSummary(
            title_of(config.objective), summary_of(config.objective), prepared.solution is not None
        ),
        problem=prepared.demos.info.problem,
        split={name: tuple(part.tolist()) for name, part in split.items()},
        metrics={name: measure(best, used, part).plain() for name, part in split.items()},
        intervals={"test": bootstrap_intervals(tabulate(best, used, split["test"]))},
        metrics_raw_state=measure_raw_state(used, split["test"], split["train"]).plain(),
        metrics_constant=measure_constant(used, split["test"]).plain(),
        metrics_of_seeds={s: g.plain() for s, g in zip(seeds, validation, strict=True)},
        versions=Provenance.current("mujoco", "jax").plain(),
    )
    embedding = replace(best, support=support, about=about)
    write_bytes(out / CARD, model_card(embedding).encode())
    embedding.save(out)
    return embedding


@dataclass(frozen=True)
class _Prepared:
    """Demonstrations ready for training."""

    demos: Demos
    """The demonstrations, with only the states that the encoder reads."""
    split: dict[str, np.ndarray]
    train_states: np.ndarray
    inputs: Inputs
    samples: Samples | None
    """None if the objective has a closed form."""
    solution: Embedding | None
    """The embedding in closed form, if the objective has one."""


def _prepare(
    demos: Demos, config: FitConfig, split_seed: int, split: dict[str, np.ndarray] | None = None
) -> _Prepared:
    split = split or demos.split(split_seed)
    quaternions = find_quaternions(demos.info, config.columns or demos.info.names, config.inputs)
    demos = demos.select(config.columns or demos.info.names)
    check_numbers("the demonstrations' states", demos.states)
    lengths = np.diff(demos.offsets)
    for name, part in split.items():
        if (lengths[part] < MIN_STATES).all():
            raise PlanspaceError(
                f"measuring takes demonstrations of {MIN_STATES} states; the longest of {len(part)} in the "
                f"{name} split has {lengths[part].max()}. Give longer ones, more of them, or another --seed."
            )
    info, states = demos.info, demos.states[demos.rows(split["train"])]
    inputs = Inputs.fit(states, info.names, info.units, info.circular_columns, config.inputs, quaternions)
    solution = config.objective.closed_form(inputs, states, config.z_dim)
    samples = None
    if solution is None:
        samples = make_samples(demos, split["train"], inputs, config, split_seed)
        check_loss(samples, config)
    return _Prepared(demos, split, states, inputs, samples, solution)


def _train_seeds(
    prepared: _Prepared, out: Path, config: FitConfig, seeds: Sequence[int], tensorboard: bool
) -> list[Embedding]:
    def scaled(embedding: Embedding) -> Embedding:
        if config.z_std == 0:
            return embedding
        how = {"whitening": config.whitening, "std": config.z_std}
        return replace(embedding, linear_map=principal_map(embedding, prepared.train_states, **how))

    def to_embeddings(models: PlanSpaceModel) -> list[Embedding]:
        return [scaled(to_numpy(models, i, prepared.inputs, config)) for i in range(len(seeds))]

    if prepared.samples is None or prepared.solution is not None:
        assert prepared.solution is not None
        return [scaled(prepared.solution)]
    tracker = open_tracker(out / "tensorboard") if tensorboard else None
    with tracker or nullcontext():
        log = _Log(out / LOG, to_embeddings, prepared.demos, prepared.split, config.steps, seeds, tracker)
        return to_embeddings(train(prepared.samples, config, seeds, out, log))


@dataclass(frozen=True)
class _Log:
    """Writer of the training log: bound, terms and path error in each row, geometry in some rows."""

    path: Path
    to_embeddings: Callable[[PlanSpaceModel], list[Embedding]]
    demos: Demos
    split: dict[str, np.ndarray]
    steps: int
    seeds: Sequence[int]
    tracker: Tracker | None

    def __call__(self, step: int, before: int, models: PlanSpaceModel, terms: dict[str, list[float]]) -> None:
        """Append a row for the steps from `before` to `step`: lists by name, with one number per seed."""
        current = self.to_embeddings(models)
        path_errors = paper_path_errors(current, self.demos, self.split["train"])
        row = {**terms, "path_error": _known(path_errors)}
        every = -(-self.steps // MEASURED)
        if step // every > before // every or step == self.steps:
            measured = [measure(e, self.demos, self.split["validation"]) for e in current]
            row |= {name: _known([getattr(g, name) for g in measured]) for name in CURVES}
        append_rows(self.path, [{"step": step, "time": time.time(), **row}], key="step")
        if self.tracker is not None:
            for i, seed in enumerate(self.seeds):
                self.tracker.add(step, {f"{name}/seed {seed}": values[i] for name, values in row.items()})


def _known(values: list[float]) -> list[float | None]:
    """Numbers for the log; None for one that cannot be measured."""
    return [None if np.isnan(value) else value for value in values]


def to_numpy(models: PlanSpaceModel, seed_index: int, inputs: Inputs, config: FitConfig) -> Embedding:
    """Convert one seed's model to an embedding that can be saved."""

    def layers(network: GaussianNetwork) -> tuple[list[np.ndarray], list[np.ndarray]]:
        return (
            [np.asarray(w)[seed_index] for w in network.weights],
            [np.asarray(b)[seed_index] for b in network.biases],
        )

    return Embedding(inputs, layers(models.encode), layers(models.decode), config.sigma_floor)


def choose(
    embeddings: list[Embedding], demos: Demos, split: dict[str, np.ndarray], config: FitConfig
) -> tuple[int, list[Geometry]]:
    """Select a seed; return its index and the validation metrics of all seeds.

    `paper` selects like `modern` if one training demonstration is long enough to measure, because a single
    demonstration has no path error.
    """
    validation = [measure(e, demos, split["validation"]) for e in embeddings]
    if config.preset == "paper":
        path_errors = paper_path_errors(embeddings, demos, split["train"])
        if not np.isnan(path_errors).any():
            return int(np.argmin(path_errors)), validation
    errors = [np.inf if np.isnan(g.midpoint_error) else g.midpoint_error for g in validation]
    scores = [(-g.active_dims, e) for g, e in zip(validation, errors, strict=True)]
    return min(range(len(scores)), key=lambda i: scores[i]), validation  # a collapsed seed only if all are
