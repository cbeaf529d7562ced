"""Training an embedding from demonstrations: several seeds at once, the best one chosen and saved."""

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planspace.demos.dataset import Demos
from planspace.embed.card import model_card
from planspace.embed.config import FitConfig
from planspace.embed.embedding import (
    CARD,
    DESCRIPTION,
    LOG,
    Embedding,
    Inputs,
    check_numbers,
    load_embedding,
)
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
from planspace.embed.networks import GaussianNetwork, PlanSpaceModel
from planspace.embed.principal import principal_components, principal_turn
from planspace.embed.samples import Samples, make_samples
from planspace.embed.support import Support
from planspace.embed.training import train
from planspace.errors import PlanspaceError
from planspace.storage.files import write_bytes
from planspace.storage.provenance import Provenance
from planspace.storage.rows import append_rows
from planspace.storage.runs import open_run
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
"""The metrics logged."""


def fit(
    demos: Demos,
    out: Path,
    *,
    config: FitConfig,
    num_seeds: int,
    seed: int,
    split_seed: int | None = None,
    tensorboard: bool = False,
) -> Embedding:
    """Trains seeds seed, seed + 1, ... at once, chooses one, and saves it in `out`.

    `modern` chooses by the midpoint error on the validation split among the seeds with no collapsed
    dimension; `paper` by the path error on the training split, as the paper does. The test split takes no
    part in either. The same call continues an interrupted one, and returns a finished one.

    Args:
        demos: the demonstrations.
        out: a folder of its own.
        config: how to train.
        num_seeds: how many seeds.
        seed: the first of them.
        split_seed: the seed of the split by demonstration; by default `seed`.
        tensorboard: whether to write the curves for TensorBoard, too.

    Raises:
        PlanspaceError: the demonstrations do not do, the folder was made with other settings, or a seed
            diverged.
    """
    split_seed = seed if split_seed is None else split_seed
    seeds = list(range(seed, seed + num_seeds))
    if config.objective.name == "pca":
        seeds = seeds[:1]  # it has a closed form
    settings = {"demos": demos.hash, "seeds": seeds, "split_seed": split_seed, "fit": asdict(config)}
    prepared = _prepare(demos, config, split_seed)  # refuses what does not do before anything is written
    open_run(out, settings)
    if (out / DESCRIPTION).exists():
        return load_embedding(out)
    embeddings = _train_seeds(prepared, out, config, seeds, tensorboard)
    split, used = prepared.split, prepared.demos
    chosen, validation = choose(embeddings, used, split, config)
    support = Support.fit(
        prepared.inputs(prepared.train_states),
        prepared.inputs(used.states[used.rows(split["validation"])]),
        np.random.default_rng(np.random.SeedSequence([split_seed, 2])),
    )
    about = {
        "preset": config.preset,
        "seed": seeds[chosen],
        "settings": settings,
        "problem": demos.info.problem,
        "split": {name: part.tolist() for name, part in split.items()},
        **_measurements(embeddings[chosen], used, split),
        "metrics_of_seeds": {str(s): asdict(g) for s, g in zip(seeds, validation, strict=True)},
        "versions": Provenance.current("mujoco", "jax").plain(),
    }
    embedding = replace(embeddings[chosen], support=support, about=about)
    write_bytes(out / CARD, model_card(embedding).encode())
    embedding.save(out)
    return embedding


def fit_seeds(
    demos: Demos, out: Path, *, config: FitConfig, seeds: Sequence[int], split_seed: int
) -> list[Embedding]:
    """Trains the given seeds and returns the embedding of each; `fit` without the choice.

    Args:
        demos: the demonstrations.
        out: where checkpoint and log are kept.
        config: how to train.
        seeds: the seeds; pca has a closed form and makes one embedding, whatever they are.
        split_seed: the seed of the split by demonstration.

    Raises:
        PlanspaceError: the demonstrations do not do, or a seed diverged.
    """
    return _train_seeds(_prepare(demos, config, split_seed), out, config, seeds, tensorboard=False)


@dataclass(frozen=True)
class _Prepared:
    """Demonstrations ready for training."""

    demos: Demos
    """With the states the encoder reads alone."""
    split: dict[str, np.ndarray]
    train_states: np.ndarray
    inputs: Inputs
    samples: Samples


def _prepare(demos: Demos, config: FitConfig, split_seed: int) -> _Prepared:
    split = demos.split(split_seed)
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
    inputs = Inputs.fit(states, info.names, info.units, info.circular_columns, config.inputs)
    samples = make_samples(demos, split["train"], inputs, config, split_seed)
    return _Prepared(demos, split, states, inputs, samples)


def _train_seeds(
    prepared: _Prepared, out: Path, config: FitConfig, seeds: Sequence[int], tensorboard: bool
) -> list[Embedding]:
    def turned(embedding: Embedding) -> Embedding:
        if config.z_deviation == 0:
            return embedding
        how = {"whitening": config.whitening, "deviation": config.z_deviation}
        return replace(embedding, turn=principal_turn(embedding, prepared.train_states, **how))

    def to_embeddings(models: PlanSpaceModel) -> list[Embedding]:
        return [turned(to_numpy(models, i, prepared.inputs, config)) for i in range(len(seeds))]

    if config.objective.name == "pca":
        return [turned(principal_components(prepared.inputs, prepared.train_states, config.z_dim))]
    tracker = open_tracker(out / "tensorboard") if tensorboard else None
    with tracker or nullcontext():
        log = _Log(out / LOG, to_embeddings, prepared.demos, prepared.split, config.steps, seeds, tracker)
        return to_embeddings(train(prepared.samples, config, seeds, out, log))


def _measurements(embedding: Embedding, demos: Demos, split: dict[str, np.ndarray]) -> dict[str, Any]:
    """The geometry on each split, with intervals on the last, beside the raw state and a constant."""
    return {
        "metrics": {name: asdict(measure(embedding, demos, part)) for name, part in split.items()},
        "intervals": {"test": bootstrap_intervals(tabulate(embedding, demos, split["test"]))},
        "metrics_raw_state": asdict(measure_raw_state(demos, split["test"], split["train"])),
        "metrics_constant": asdict(measure_constant(demos, split["test"])),
    }


@dataclass(frozen=True)
class _Log:
    """The curves: in every row the bound, its terms and the path error; now and then the geometry."""

    path: Path
    to_embeddings: Callable[[PlanSpaceModel], list[Embedding]]
    demos: Demos
    split: dict[str, np.ndarray]
    steps: int
    seeds: Sequence[int]
    tracker: Tracker | None

    def __call__(self, step: int, before: int, models: PlanSpaceModel, terms: dict[str, list[float]]) -> None:
        """Appends a row for the steps from `before` to `step`: numbers by name, one for each seed."""
        current = self.to_embeddings(models)
        row = {**terms, "path_error": paper_path_errors(current, self.demos, self.split["train"])}
        every = -(-self.steps // MEASURED)
        if step // every > before // every or step == self.steps:
            measured = [measure(e, self.demos, self.split["validation"]) for e in current]
            row |= {name: [getattr(g, name) for g in measured] for name in CURVES}
        append_rows(self.path, [{"step": step, "time": time.time(), **row}], key="step")
        if self.tracker is not None:
            for i, seed in enumerate(self.seeds):
                self.tracker.add(step, {f"{name}/seed {seed}": values[i] for name, values in row.items()})


def to_numpy(models: PlanSpaceModel, seed_index: int, inputs: Inputs, config: FitConfig) -> Embedding:
    """One seed's model as what is saved."""

    def layers(network: GaussianNetwork) -> tuple[list[np.ndarray], list[np.ndarray]]:
        return (
            [np.asarray(w)[seed_index] for w in network.weights],
            [np.asarray(b)[seed_index] for b in network.biases],
        )

    return Embedding(inputs, layers(models.encode), layers(models.decode), config.sigma_floor)


def choose(
    embeddings: list[Embedding], demos: Demos, split: dict[str, np.ndarray], config: FitConfig
) -> tuple[int, list[Geometry]]:
    """The seed to keep, and the validation metrics of all."""
    validation = [measure(e, demos, split["validation"]) for e in embeddings]
    if config.preset == "paper":
        return int(np.argmin(paper_path_errors(embeddings, demos, split["train"]))), validation
    scores = [(-g.active_dims, g.midpoint_error) for g in validation]  # a collapsed seed only if all are
    return min(range(len(scores)), key=lambda i: scores[i]), validation
