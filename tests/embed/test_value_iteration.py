"""The shortest times of `benchmarks/value_iteration.py`, where they are known in closed form."""

from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.folder import DemoFolder
from planspace.demos.load import load_demos
from planspace.physics.angles import wrap
from planspace.plan.demonstrations import state_info
from planspace.tasks.problem_file import load_problem

TOLERANCE = 0.02
CONTROLS = np.array([[-1.0], [1.0]])

pytestmark = pytest.mark.usefixtures("benchmarks")


def pushed(states: np.ndarray, controls: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """x'' = u; positions beyond 2 are invalid."""
    x, v = states.T
    u = controls[:, 0]
    ends = np.stack([x + v * dt + 0.5 * u * dt**2, v + u * dt], axis=1)
    return ends, np.abs(ends[:, 0]) <= 2.0


def pushed_time(states: np.ndarray) -> np.ndarray:
    """Full push until x = -v |v| / 2, then full brake: T = s v + 2 sqrt(v^2 / 2 + s x), s the side of x."""
    x, v = states.T
    side = np.sign(x + 0.5 * v * np.abs(v))
    return side * v + 2 * np.sqrt(np.maximum(0.5 * v**2 + side * x, 0.0))


def reached(states: np.ndarray) -> np.ndarray:
    return np.abs(states).sum(axis=1) <= TOLERANCE


def test_the_times_of_a_double_integrator(rng: np.random.Generator) -> None:
    import value_iteration as vi

    grid = vi.Grid((vi.make_axis(-2.0, 2.0, 0.005, 60.0), vi.make_axis(-2.0, 2.0, 0.005, 60.0)))
    states = np.clip(grid.deltas, -2.0, 2.0)
    values = vi.iterate(grid, states, lambda x: x, reached, pushed, CONTROLS)
    inside = rng.uniform(-1.0, 1.0, (200, 2))  # from here the shortest way stays between -2 and 2
    late = values(inside) - pushed_time(inside)
    assert late.max() < 0.06 and np.median(np.abs(late)) < 0.03
    assert late.min() > -2 * TOLERANCE**0.5  # the edge of the region, at rest, is that far from its centre
    assert values(np.array([[1.95, 1.95]]))[0] > 0.9 * vi.LONGEST  # it cannot stop before 2


def test_angles_go_the_short_way_round(rng: np.random.Generator) -> None:
    import value_iteration as vi

    def turned(states: np.ndarray, controls: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        return states + controls * dt, np.ones(len(states), dtype=bool)

    def difference(states: np.ndarray) -> np.ndarray:
        return wrap(states - 3.0)

    grid = vi.Grid((vi.circle_axis(0.005, 60.0),))
    values = vi.iterate(
        grid, 3.0 + grid.deltas, difference, lambda x: reached(difference(x)), turned, CONTROLS
    )
    angles = rng.uniform(-9.0, 9.0, (100, 1))
    known = np.maximum(np.abs(wrap(angles - 3.0))[:, 0] - TOLERANCE, 0.0)
    np.testing.assert_allclose(values(angles), known, atol=0.02)


def test_a_grid_finds_the_cell_of_its_own_nodes() -> None:
    import value_iteration as vi

    grid = vi.Grid((vi.make_axis(-1.0, 3.0, 0.1, 5.0), vi.circle_axis(0.2, 4.0)))
    assert grid.axes[0].nodes[0] <= -1.0 and grid.axes[0].nodes[-1] >= 3.0
    np.testing.assert_allclose(grid.axes[1].nodes[[0, -1]], [-np.pi, np.pi])
    assert np.diff(grid.axes[0].nodes).min() == pytest.approx(0.1, rel=0.01)
    corner, part = grid.cells(grid.deltas)
    placed = sum(
        offset * part[:, k] for k, offset in enumerate((grid.shape[1], 1))
    )  # a node may lie at the end of the cell before it
    np.testing.assert_allclose(corner + placed, np.arange(len(grid.deltas)), atol=1e-3)


def test_the_time_between_two_states_of_a_plan(demos: Demos, rng: np.random.Generator) -> None:
    import true_times

    plant = true_times.Plant(load_problem("cartpole-swingup"))
    pairs = true_times.pairs_on_paths(plant, [demos.episode(i).states for i in range(4)], 20, rng)
    for start, goal, seconds in zip(pairs["states"], pairs["goals"], pairs["time"], strict=True):
        first = np.flatnonzero((demos.states == start).all(axis=1))[0]
        steps = round(seconds / plant.dt)
        distance = np.abs(plant.space.difference(demos.states[first : first + steps + 1], goal)).sum(axis=1)
        assert distance[-1] <= 0.1 and (distance[:-1] > 0.1).all()


def test_random_states_are_valid_and_different(rng: np.random.Generator) -> None:
    import true_times

    plant = true_times.Plant(load_problem("cartpole-swingup"))
    states = plant.random_states(50, rng)
    assert len(np.unique(states, axis=0)) == 50
    assert (np.abs(states[:, [0, 2, 3]]) <= [1.0, 3.0, 10.0]).all()


def test_random_motions_are_kept_as_demonstrations(rng: np.random.Generator, tmp_path: Path) -> None:
    import random_motions
    import true_times

    plant = true_times.Plant(load_problem("cartpole-swingup"))
    motions = random_motions.polished_motions(plant, 2, rng)
    made = [random_motions.episode_of(motion, plant.dt, 5 + k) for k, motion in enumerate(motions)]
    DemoFolder(tmp_path / "motions", state_info(plant.problem), {}).append(made, 7)
    kept = load_demos(tmp_path / "motions")
    episodes = [kept.episode(i) for i in range(len(kept))]
    assert [episode.index for episode in episodes] == [5, 6]
    for motion, episode in zip(motions, episodes, strict=True):
        np.testing.assert_array_equal(episode.states, motion.states)
        np.testing.assert_array_equal(episode.controls, motion.controls)
        assert episode.times[-1] == pytest.approx(len(motion.controls) * plant.dt)
        moved = episode.states[0]
        for control in episode.controls:
            moved, valid = (x[0] for x in plant.step(moved[None], control[None], plant.dt))
            assert valid
        np.testing.assert_allclose(moved, episode.states[-1], atol=1e-6)


def test_the_table_of_the_docs_is_that_of_the_results() -> None:
    import csv_rows
    import true_times_table

    lines = true_times_table.table(csv_rows.read_rows(true_times_table.FILE))
    text = (Path(__file__).parents[2] / "docs" / "appendix" / "embeddings.md").read_text()
    assert len(lines) >= 10 and "\n".join(lines) in text
