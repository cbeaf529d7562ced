"""Steps along plans, and the regulators that lead back to them."""

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.errors import UsageError
from planspace.physics.simulator import Simulator
from planspace.plan.tracking import TrackedPlans, average_controls, next_rows
from planspace.tasks.problem_file import load_problem

STEPS = 60


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(*load_problem("cartpole-swingup").compile(), 1)


@pytest.fixture(scope="module")
def swings(demos: Demos, simulator: Simulator) -> Demos:
    """Two swings under weak controls, which a regulator may change in both directions."""
    episodes, step = [], float(simulator.model.opt.timestep)
    for phase in (0.0, 1.0):
        states, controls = (
            [np.array([0.0, np.pi + 0.2, 0.0, 0.0])],
            np.sin(phase + 0.1 * np.arange(STEPS))[:, None],
        )
        for control in controls:
            simulator.reset(states[-1][None])
            simulator.step(control[None], 1)
            states.append(simulator.states()[0].copy())
        times = step * np.arange(STEPS + 1)
        episodes.append(Episode(np.stack(states), controls, times, states[-1], True, len(episodes), 0))
    return Demos.from_episodes(demos.info, episodes)


@pytest.mark.parametrize("physics_steps", [1, 4])
def test_plans_are_cut_into_steps(swings: Demos, simulator: Simulator, physics_steps: int) -> None:
    tracks, count = TrackedPlans.of(swings, simulator, physics_steps, STEPS), STEPS // physics_steps
    np.testing.assert_array_equal(tracks.remaining, 2 * [*range(count, 0, -1)])
    np.testing.assert_array_equal(tracks.states[count:], swings.states[STEPS + 1 : -1 : physics_steps])
    means = swings.controls.reshape(-1, physics_steps).mean(axis=1)
    np.testing.assert_allclose(tracks.controls[:, 0], means)
    ends = TrackedPlans.of(swings, simulator, physics_steps, 5)
    kept = tracks.remaining <= 5
    np.testing.assert_array_equal(ends.states, tracks.states[kept])
    np.testing.assert_array_equal(ends.remaining, tracks.remaining[kept])
    with pytest.raises(UsageError, match="no plan has a step of 20 s"):
        TrackedPlans.of(swings, simulator, 1000, 5)


def test_the_cost_to_go_is_what_the_way_back_costs_and_without_feedback_it_costs_more(
    swings: Demos, simulator: Simulator
) -> None:
    tracks, first = TrackedPlans.of(swings, simulator, 1, STEPS), np.zeros(1, dtype=int)
    spread = np.std(tracks.states - tracks.states[0], axis=0)
    half = (simulator.control_high - simulator.control_low) / 2
    start = tracks.states[:1] + 1e-4 * spread

    def cost(feedback: float) -> float:
        simulator.reset(start)
        total = 0.0
        for row in np.arange(STEPS - 1)[:, None]:
            off = tracks.off(row, simulator.states())
            controls = tracks.control(row, feedback * off)
            total += ((off / spread) ** 2).sum() + (((controls - tracks.controls[row]) / half) ** 2).sum()
            simulator.step(controls, 1)
        last = first + STEPS - 1
        return float(total + tracks.cost_to_go(last, tracks.off(last, simulator.states()))[0])

    said = tracks.cost_to_go(first, tracks.off(first, start))[0]
    assert cost(1.0) == pytest.approx(said, rel=0.01)
    assert cost(0.0) > 1.2 * said


def test_the_next_row_is_the_nearest_in_time_of_the_same_plan(demos: Demos) -> None:
    rows = np.concatenate([np.arange(*demos.offsets[i : i + 2]) for i in (0, 1)])
    spacing = demos.times[1]
    found = next_rows(demos, rows, 2 * spacing)
    first = demos.offsets[1]
    np.testing.assert_array_equal(found[: first - 2], np.arange(2, first))
    np.testing.assert_array_equal(found[first - 2 : first], -1)
    assert found[first] == first + 2
    np.testing.assert_array_equal(next_rows(demos, rows, 0.4 * spacing), -1)  # no row but its own is near


def test_controls_are_averaged_over_the_step_whatever_the_times() -> None:
    times, controls = np.array([0.0, 0.1, 0.4, 0.5]), np.array([[1.0], [2.0], [4.0]])
    plan = Episode(np.zeros((4, 2)), controls, times, np.zeros(2), True, 0, 0)
    found = average_controls(plan, 0.2)
    np.testing.assert_allclose(found, [[1.5], [2.0]])  # the others have less than 0.2 s left
    begun = average_controls(plan, 0.2, np.array([0.05, 0.25]))
    np.testing.assert_allclose(begun, [[1.75], [2.5]])
    np.testing.assert_allclose(average_controls(plan, 0.1 * (1 + 1e-9)), [[1.0], [2.0], [4.0]], rtol=1e-6)
