from dataclasses import replace

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.fit import fit_embedding
from planspace.embed.folds import measure_folds
from planspace.embed.geometry import tabulate
from planspace.embed.measurement import measure_embedding
from planspace.errors import PlanspaceError, UsageError


def test_each_demonstration_is_measured_by_principal_components_of_the_others(demos: Demos) -> None:
    """Three folds of closed-form embeddings, done again by hand."""
    embedding = fit_embedding(demos, "pca", verbose=False)
    found = measure_embedding(embedding, demos, folds=3, verbose=False)
    assert list(found.splits) == ["train", "validation", "test", "folds"]
    part = found.splits["folds"]
    assert part.embedding.num_demos == part.raw_state.num_demos == len(demos) == 12
    states = demos.states
    expected = []
    for fold in np.array_split(np.random.default_rng(0).permutation(12), 3):
        rows = demos.rows(np.setdiff1d(np.arange(12), fold))
        inputs = embedding.inputs.fit(
            states[rows], demos.info.names, demos.info.units, demos.info.circular_columns, "trig"
        )
        x = inputs(states[rows])
        axes = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2][:3]
        mu = (x - x.mean(axis=0)) @ axes.T
        whitened = axes.T * mu.std(axis=0) ** -0.2  # `whitening` of `modern`; straightness has no scale
        for i in fold:
            z = inputs(demos.episode(int(i)).states) @ whitened
            expected.append(np.linalg.norm(z[-1] - z[0]) / np.linalg.norm(np.diff(z, axis=0), axis=1).sum())
    assert part.embedding.straightness == pytest.approx(np.mean(expected), rel=1e-4)
    assert part.embedding.path_error > 0 and part.embedding.missing() == {}
    low, high = part.intervals["path_error"]
    assert 0 < low < high
    assert not {"effective_rank", "active_dims"} & set(part.intervals)


@pytest.mark.nightly
def test_a_trained_embedding_is_trained_again_with_its_settings(embedding: Embedding, demos: Demos) -> None:
    about = embedding.require_about()
    found, _, episodes = measure_folds(about, demos, 2)
    again, _, _ = measure_folds(about, demos, 2)
    assert found == again  # deterministic
    assert len(episodes) == found.num_demos == 12 and found.active_dims <= 3
    trained = tabulate(embedding, demos, np.array(about.split["train"])).straightness.mean()
    assert 0.2 * trained < found.straightness < 1.5 * trained
    weak = measure_embedding(embedding, demos, folds=2, verbose=False).to_dict()["verdict"]["weak"]
    assert not any("could be measured" in sentence for sentence in weak)


@pytest.mark.parametrize("folds", [1, 13, -2])
def test_an_impossible_number_of_folds_is_refused(folds: int, embedding: Embedding, demos: Demos) -> None:
    with pytest.raises(UsageError, match=f"between 2 and the number of demonstrations, 12, got {folds}"):
        measure_embedding(embedding, demos, folds=folds, verbose=False)


def test_other_demonstrations_and_own_objectives_are_refused(embedding: Embedding, demos: Demos) -> None:
    with pytest.raises(PlanspaceError, match="the dataset that the embedding was trained on"):
        measure_embedding(embedding, replace(demos, states=demos.states * 1.01), folds=3, verbose=False)
    about = embedding.require_about()
    fit = {**about.settings.fit, "objective": {"name": "mine", "source_sha256": "0"}}
    own = replace(embedding, about=replace(about, settings=replace(about.settings, fit=fit)))
    with pytest.raises(UsageError, match="the objective mine is your own code"):
        measure_embedding(own, demos, folds=3, verbose=False)
