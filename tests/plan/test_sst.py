import itertools
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from planspace.errors import UsageError
from planspace.physics.simulator import Simulator
from planspace.plan import tree as tree_module
from planspace.plan.config import RegulatorConfig
from planspace.plan.query import Query
from planspace.plan.regulator import Regulator
from planspace.plan.sst import SST
from planspace.plan.sst_search import SearchResult, SSTSearch
from planspace.plan.tree import Tree
from planspace.tasks.problem import IDLE_COST, Problem
from planspace.tasks.problem_file import load_problem

CONFIG = SST(extensions=256, min_rounds=4, max_rounds=40)
HANGING = np.array([0.0, np.pi, 0.0, 0.0])


def query(seed: int, config: SST = CONFIG, problem: Problem | None = None) -> SSTSearch:
    problem = problem or load_problem("cartpole-swingup")
    model, space = problem.compile()
    simulator = Simulator(model, space, max(config.extensions, 16), threads=1)
    goal = problem.draw_goal(space, np.random.default_rng(0))
    regulator = Regulator(simulator, goal, problem.weights(space), RegulatorConfig())
    return SSTSearch(config, Query(problem, HANGING, goal, simulator, regulator), np.random.default_rng(seed))


def solve(seed: int, config: SST = CONFIG, problem: Problem | None = None) -> SearchResult:
    return query(seed, config, problem).solve()


def test_swings_up_from_hanging_and_is_deterministic() -> None:
    first, again, other = solve(0), solve(0), solve(1)
    assert first.arrived and other.arrived
    np.testing.assert_array_equal(first.controls, again.controls)
    assert first.controls.shape != other.controls.shape or (first.controls != other.controls).any()
    assert np.abs(first.controls).max() <= 3.0
    assert first.cost == pytest.approx(0.02 * len(first.controls))  # 0.02 s per step
    simulator = query(0).simulator
    ids = np.array([0], dtype=np.int32)
    simulator.reset(HANGING[None], ids)
    for control in first.controls:
        simulator.step(control[None], ids=ids)
    assert query(0).goal.reached(simulator.states()[:1]).all()


def test_more_rounds_never_make_a_longer_plan() -> None:
    short, long = solve(3), solve(3, replace(CONFIG, min_rounds=20))
    assert long.cost <= short.cost


@pytest.mark.slow
def test_minimising_effort_gives_plans_with_less_effort() -> None:
    problem = replace(load_problem("cartpole-swingup"), cost="effort")
    config = replace(CONFIG, min_rounds=30)
    light = solve(0, config, problem)
    simulator = query(0).simulator
    # each step of 0.02 s costs a tenth for its time, and its control as a fraction of the largest, 3
    expected = 0.02 * (IDLE_COST * len(light.controls) + np.abs(light.controls).sum() / 3)
    assert light.cost == pytest.approx(expected)
    quick = solve(0, config)
    assert light.cost < problem.step_cost(simulator, quick.controls).sum()


def test_a_budget_of_seconds_is_used_up_to_improve(monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = itertools.count()  # a clock that advances one second per call
    monkeypatch.setattr("planspace.plan.sst_search.time", SimpleNamespace(monotonic=lambda: next(rounds)))
    found = solve(0, replace(CONFIG, seconds=40.0, max_rounds=1))
    assert found.arrived and found.simulated_steps > 10 * 256
    assert next(rounds) == 42  # one call at the start, 40 rounds, and the call that ends the search


def test_gives_up_within_its_budget_and_reports_the_nearest_distance() -> None:
    found = solve(0, SST(extensions=8, min_rounds=1, max_rounds=1))
    assert not found.arrived
    assert 1.0 < found.nearest <= np.pi  # it started pi away


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"extensions": 0}, "`extensions` must be at least 1, got 0."),
        ({"shrink": 0.0}, "`shrink` must be above 0 and at most 1, got 0.0."),
        ({"shrink": 1.5}, "`shrink` must be above 0 and at most 1, got 1.5."),
        ({"min_edge_s": 0.3}, "`min_edge_s` must be above 0 and at most max_edge_s, 0.2, got 0.3."),
        ({"bang_bang": 2.0}, "`bang_bang` must be between 0 and 1, got 2.0."),
        ({"seconds": -1.0}, "`seconds` must be at least 0, got -1.0."),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict, message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        SST(**wrong)


def make_tree(rng: np.random.Generator, rounds: int) -> Tree:
    one = query(0)
    tree = Tree(HANGING, one.problem, one.simulator, 0.2)
    for _ in range(rounds):
        parents = rng.integers(0, len(tree.costs), 64)
        states = np.clip(tree.states[parents] + rng.normal(0, 0.3, (64, 4)), -1, 1)
        tree.add(parents, rng.uniform(-3, 3, (64, 1)), rng.integers(1, 11, 64), states)
    return tree


def members(tree: Tree) -> dict[tuple, list[int]]:
    """Nodes by their cell, found without the tree's own hashing."""
    cells: dict[tuple, list[int]] = {}
    for node, row in enumerate(np.floor(tree.features / tree.cell_size).astype(int).tolist()):
        cells.setdefault(tuple(row), []).append(node)
    return cells


@pytest.mark.parametrize("shrinks", [0, 3])
def test_each_witness_cell_is_represented_by_its_cheapest_node(
    rng: np.random.Generator, shrinks: int
) -> None:
    tree = make_tree(rng, 30)
    for _ in range(shrinks):
        tree.shrink(0.8)
    cells = members(tree)
    assert len(cells) == len(tree._cells)
    for nodes in cells.values():
        winner = tree._winner[tree._cell[nodes[0]]]
        assert winner in nodes and tree.costs[winner] == min(tree.costs[nodes])


def test_shrinking_restores_displaced_nodes(rng: np.random.Generator) -> None:
    tree = make_tree(rng, 30)
    before = set(tree._winner.tolist())
    tree.shrink(0.5)
    after = set(tree._winner.tolist())
    assert before < after  # all representatives stay, and some nodes are added


def test_costs_are_the_sum_of_durations_to_the_root(rng: np.random.Generator) -> None:
    tree = make_tree(rng, 10)
    for node in rng.integers(0, len(tree.costs), 20):
        assert 0.02 * len(tree.path(int(node))) == pytest.approx(tree.costs[node])


def test_neighbours_agree_with_a_full_search(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tree_module, "NEIGHBOUR_SLACK", 0.0)
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
