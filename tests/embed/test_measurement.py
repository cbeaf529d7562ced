from dataclasses import replace

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.embed.embedding import Embedding
from planspace.embed.inputs import Inputs
from planspace.embed.measurement import measure_embedding
from planspace.errors import PlanspaceError


def test_the_demonstrations_of_the_training_are_measured_by_split(embedding: Embedding, demos: Demos) -> None:
    found = measure_embedding(embedding, demos).to_dict()
    assert set(found["splits"]) == {"train", "validation", "test"}
    assert found["splits"]["test"]["embedding"] == embedding.require_about().metrics["test"]
    assert found["splits"]["train"]["embedding"]["num_demos"] == 10
    for part in found["splits"].values():
        for metric, (low, high) in part["intervals"].items():
            value = part["embedding"][metric]
            if part["embedding"]["num_demos"] > 1 and metric not in ("path_error_std", "effective_rank"):
                assert low - 1e-6 <= value <= high + 1e-6, metric
    assert found["checks"]["change_by_a_turn"] < 1e-4
    assert found["checks"]["outside_support"] < 0.2


def test_a_measurement_has_a_short_representation(embedding: Embedding, demos: Demos) -> None:
    found = measure_embedding(embedding, demos)
    assert repr(found).startswith("Measurement on 1 demonstrations, test split: z (raw state)\n")
    assert "change by a turn" in repr(found) and len(repr(found).splitlines()) <= 10
    assert "<table><caption>Measurement on" in found._repr_html_()


def test_other_demonstrations_are_measured_as_one_split(embedding: Embedding, demos: Demos) -> None:
    other = replace(demos, states=demos.states * 1.01)
    assert list(measure_embedding(embedding, other).splits) == ["all"]


def test_a_full_turn_changes_z_of_raw_angles(embedding: Embedding, demos: Demos) -> None:
    i = embedding.inputs
    weights = [w.copy() for w in embedding.encoder[0]]
    weights[0] = weights[0][:, :4]
    inputs = Inputs(i.names, i.units, i.circular_columns, "raw", np.zeros(4), np.ones(4))
    raw = replace(embedding, inputs=inputs, encoder=(weights, embedding.encoder[1]), support=None)
    decoder = [w.copy() for w in raw.decoder[0]]
    decoder[-1] = decoder[-1][:8]
    biases = [*raw.decoder[1][:-1], raw.decoder[1][-1][:8]]
    found = measure_embedding(replace(raw, decoder=(decoder, biases)), demos).to_dict()["checks"]
    assert found["change_by_a_turn"] > 0.1
    assert "outside_support" not in found


@pytest.mark.parametrize("test", [(10**6,), (10**30,), (-1,), (0,), ()])
def test_an_impossible_split_is_rejected(test: tuple[int, ...], embedding: Embedding, demos: Demos) -> None:
    about = embedding.require_about()
    split = {**about.split, "train": (0, *about.split["train"]), "test": test}
    embedding = replace(embedding, about=replace(about, split=split))
    with pytest.raises(PlanspaceError, match="does not assign each of them to one of"):
        measure_embedding(embedding, demos)


def test_an_embedding_without_a_training_record_is_measured_on_one_split(
    embedding: Embedding, demos: Demos
) -> None:
    assert list(measure_embedding(replace(embedding, about=None), demos).splits) == ["all"]


def test_huge_numbers_are_refused(embedding: Embedding, demos: Demos) -> None:
    states = demos.states.copy()
    states[3] = 1e300
    with pytest.raises(PlanspaceError, match="states contain a number that is not finite, or larger than 1e"):
        measure_embedding(embedding, replace(demos, states=states))
    states[3] = 0.99e15  # allowed in a state, but z becomes too large
    weights = [weight * np.float32(1e15) for weight in embedding.encoder[0]]
    scaled = replace(embedding, encoder=(weights, embedding.encoder[1]))
    with pytest.raises(PlanspaceError, match="z of these states, or .* contain a number"):
        measure_embedding(scaled, replace(demos, states=states))


def test_one_test_demonstration_is_not_perfect(embedding: Embedding, demos: Demos) -> None:
    found = measure_embedding(embedding, demos).to_dict()["splits"]["test"]
    for column in ("embedding", "raw_state", "constant"):
        assert found[column]["path_error"] is None and found[column]["duration_error"] is None
    assert found["intervals"] == {}
    assert set(found["not_available"]) == {"path_error", "path_error_std", "duration_error", "intervals"}
