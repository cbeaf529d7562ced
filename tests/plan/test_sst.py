import numpy as np

from planspace.physics.simulate import Simulator
from planspace.plan.polish import GoalRegulator, TailConfig
from planspace.plan.problem import load_problem
from planspace.plan.sst import SST, SSTConfig, _Tree

CONFIG = SSTConfig(extensions=256, min_rounds=4, max_rounds=40)
HANGING = np.array([0.0, np.pi, 0.0, 0.0])


def solve(seed: int, config: SSTConfig = CONFIG):
    problem = load_problem("cartpole-swingup")
    model, space = problem.compile()
    simulator = Simulator(model, space, max(config.extensions, 16), threads=1)
    weights = np.array(problem.feature_weights)
    regulator = GoalRegulator(simulator, np.zeros(4), weights, TailConfig())
    return SST(problem, simulator, regulator, config, np.random.default_rng(seed)).solve(HANGING)


def test_swings_up_from_hanging_and_is_deterministic() -> None:
    first, again, other = solve(0), solve(0), solve(1)
    assert first is not None and again is not None and other is not None
    np.testing.assert_array_equal(first.controls, again.controls)
    np.testing.assert_array_equal(first.durations, again.durations)
    assert first.controls.shape != other.controls.shape or (first.controls != other.controls).any()
    assert np.abs(first.controls).max() <= 3.0


def test_more_rounds_never_make_a_longer_plan() -> None:
    short, long = solve(3), solve(3, SSTConfig(extensions=256, min_rounds=20, max_rounds=40))
    assert short is not None and long is not None
    assert long.cost <= short.cost


def test_gives_up_within_its_budget() -> None:
    assert solve(0, SSTConfig(extensions=8, min_rounds=1, max_rounds=1)) is None


def make_tree(rng: np.random.Generator, rounds: int) -> _Tree:
    _, space = load_problem("cartpole-swingup").compile()
    tree = _Tree(HANGING, space, np.ones(4), 0.2)
    for _ in range(rounds):
        parents = rng.integers(0, len(tree.costs), 64)
        states = np.clip(tree.states[parents] + rng.normal(0, 0.3, (64, 4)), -1, 1)
        tree.add(parents, rng.uniform(-3, 3, (64, 1)), rng.integers(1, 11, 64), states)
    return tree


def test_one_cheapest_representative_a_witness_cell(rng: np.random.Generator) -> None:
    tree = make_tree(rng, 30)
    for cell, node in tree.cells.items():
        members = [i for i, c in enumerate(tree._cells(tree.features)) if c == cell]
        assert tree.costs[node] == min(tree.costs[members])


def test_costs_are_the_sum_of_durations_to_the_root(rng: np.random.Generator) -> None:
    tree = make_tree(rng, 10)
    for node in rng.integers(0, len(tree.costs), 20):
        _, durations = tree.path(int(node))
        assert durations.sum() == tree.costs[node]


def test_neighbours_agree_with_a_full_search_however_the_index_is_split(rng: np.random.Generator) -> None:
    tree = make_tree(rng, 5)
    for _ in range(4):
        targets = rng.uniform(-1, 1, (32, tree.features.shape[1]))
        distances, nodes = tree._neighbours(targets)
        full = np.linalg.norm(targets[:, None] - tree.features[None], axis=2)
        np.testing.assert_allclose(distances, np.sort(full, axis=1)[:, : distances.shape[1]])
        np.testing.assert_allclose(np.take_along_axis(full, nodes, axis=1), distances)
        parents = rng.integers(0, len(tree.costs), 16)
        states = rng.uniform(-1, 1, (16, 4))
        tree.add(parents, np.zeros((16, 1)), np.ones(16, dtype=int), states)


def test_best_near_selection_prefers_the_cheapest_within_the_radius(rng: np.random.Generator) -> None:
    tree = make_tree(rng, 20)
    targets = rng.uniform(-1, 1, (64, tree.features.shape[1]))
    wide, narrow = tree.select(targets, 5.0), tree.select(targets, 0.0)
    assert tree.costs[wide].mean() < tree.costs[narrow].mean()
