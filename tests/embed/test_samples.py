from dataclasses import replace

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.embed.config import PAPER_SPACINGS, PRESETS
from planspace.embed.inputs import Inputs
from planspace.embed.objectives.shuffled import Shuffled
from planspace.embed.samples import make_samples
from planspace.embed.triplet_source import TripletSource
from planspace.errors import PlanspaceError


def inputs_of(demos: Demos) -> Inputs:
    info = demos.info
    return Inputs.fit(demos.states, info.names, info.units, info.circular_columns, "trig")


def test_samples_know_the_fraction_of_time_and_the_duration(demos: Demos) -> None:
    config, train = PRESETS["modern"], np.arange(3)
    samples = make_samples(demos, train, inputs_of(demos), config, 0)
    batch = samples.draw(jr.key(0), 1000)
    mean_duration = np.mean([demos.episode(i).times[-1] for i in range(3)])
    rows = np.asarray(samples.triplets)
    owner = np.searchsorted(demos.offsets, rows, side="right") - 1
    assert (owner == owner[:, :1]).all() and owner.max() <= 2
    t_a, t_t, t_b = demos.times[rows].T
    np.testing.assert_allclose(samples.w, (t_t - t_a) / (t_b - t_a), rtol=1e-5)
    np.testing.assert_allclose(samples.duration, (t_b - t_a) / mean_duration, rtol=1e-5)
    assert 0 < float(batch.w.min()) < 0.2 and 0.8 < float(batch.w.max()) < 1
    # the longest triplets span whole demonstrations
    assert float(samples.duration.max()) == pytest.approx(
        max(demos.episode(i).times[-1] for i in range(3)) / mean_duration, rel=1e-5
    )


def test_with_spacings_the_fraction_of_time_is_one_half(demos: Demos) -> None:
    config = replace(PRESETS["modern"], spacings=PAPER_SPACINGS)
    samples = make_samples(demos, np.arange(3), inputs_of(demos), config, 0)
    np.testing.assert_allclose(samples.w, 0.5, rtol=1e-4)


def test_states_off_the_demonstrations_have_valid_angles_and_a_wider_range(demos: Demos) -> None:
    inputs = inputs_of(demos)
    samples = make_samples(demos, np.arange(8), inputs, PRESETS["modern"], 0)
    batch = samples.draw(jr.key(0), 3000)
    states = inputs.invert(np.asarray(batch.off_data))
    x = np.asarray(batch.off_data) * inputs.std + inputs.mean
    np.testing.assert_allclose(x[:, 1] ** 2 + x[:, 2] ** 2, 1.0, atol=1e-4)  # sin and cos of one angle
    train = demos.states[demos.rows(np.arange(8))]
    middle = np.asarray(samples.triplets)[:, 1]
    spread = demos.states[middle].std(axis=0)
    for column in (0, 2, 3):  # 1.5 times as wide
        assert states[:, column].std() == pytest.approx(1.5 * spread[column], rel=0.1)
    assert np.abs(np.corrcoef(states[:, 1], states[:, 3])[0, 1]) < 0.1  # combined at random
    assert np.abs(np.corrcoef(train[:, 1], train[:, 3])[0, 1]) > 0.2  # correlated in plans


def test_shuffled_triplets_have_the_same_states_and_times_in_another_order(demos: Demos) -> None:
    def source() -> TripletSource:
        return TripletSource(demos, np.arange(8), (1,), 0.5, np.random.default_rng(0))

    rows, times = source().standard()
    mixed, same_times = Shuffled().draw_triplets(source())
    np.testing.assert_array_equal(times, same_times)
    for old, new in zip(rows.T, mixed.T, strict=True):
        assert sorted(old) == sorted(new)
    assert np.mean(mixed[:, 1] - mixed[:, 0] == 1) < 0.1


def test_e2c_draws_single_steps_with_their_controls(demos: Demos) -> None:
    config = PRESETS["modern"].with_objective("e2c")
    samples = make_samples(demos, np.arange(len(demos)), inputs_of(demos), config, 0)
    a, t, _ = np.asarray(samples.triplets).T
    assert (t == a + 1).all()
    first = demos.episode(1)
    row = int(demos.offsets[1])
    expected = first.controls[0] / demos.controls.std(axis=0)
    np.testing.assert_allclose(samples.controls[row], expected, rtol=1e-5)
    assert (
        float(jnp.abs(samples.controls[row - 1]).max()) == 0.0
    )  # the last state of a demonstration has no control


def test_e2c_without_controls_is_refused() -> None:
    info = StateInfo(("x",), ("m",), (), 0)
    x = np.linspace(0, 1, 20)[:, None]
    demos = Demos.from_episodes(
        info, [Episode(x, np.zeros((19, 0)), np.arange(20) * 0.1, np.zeros(1), True, 0, 0)] * 3
    )
    with pytest.raises(PlanspaceError, match="e2c needs controls"):
        make_samples(demos, np.arange(3), inputs_of(demos), PRESETS["modern"].with_objective("e2c"), 0)
