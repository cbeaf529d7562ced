"""Plans that keep the trees of their searches."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree

import planspace as ps
from planspace.cli import main
from planspace.demos.episode import Episode
from planspace.demos.load import load_demos
from planspace.demos.search_tree import SearchTree
from planspace.errors import UsageError
from planspace.physics.replay import advance
from planspace.plan import Failure, Plan, PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.plan.pipeline import Pipeline
from planspace.plan.sst import SST
from planspace.plan.tree import Tree
from planspace.tasks.problem_file import load_problem

CARTPOLE = load_problem("cartpole")
QUICK = PlanConfig.for_problem(CARTPOLE, extensions=64, restarts=1, polish_max_iterations=0)
KEEP = replace(QUICK, keep_trees=True, tree_nodes=100)


def test_every_edge_of_a_stored_tree_replays(monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[Tree] = []
    search_tree = Tree.search_tree
    monkeypatch.setattr(Tree, "search_tree", lambda self: searched.append(self) or search_tree(self))
    problem = load_problem("pendulum")
    config = PlanConfig.for_problem(problem, restarts=1, polish_max_iterations=0, keep_trees=True)
    pipeline = Pipeline(problem, replace(config, tree_nodes=300))
    episode = pipeline.plan(0, 0)
    assert isinstance(episode, Episode) and episode.tree is not None
    tree, full = episode.tree, searched[-1]
    assert len(tree) == 300 < len(full.costs)
    np.testing.assert_array_equal(tree.states[0], episode.states[0])

    shift = episode.states[0] - full.states[0]  # whole turns of the hinge
    far, nodes = cKDTree(full.states + shift).query(tree.states)
    assert far.max() < 1e-9
    np.testing.assert_allclose(tree.times, full.costs[nodes])  # the cost of this problem is the duration
    step, data = pipeline.model.opt.timestep, mujoco.MjData(pipeline.model)
    for node in range(1, len(tree)):
        mujoco.mj_resetData(pipeline.model, data)
        pipeline.space.write(tree.states[tree.parents[node]], data.qpos, data.qvel, data.act)
        steps = round(tree.durations[node] / step)
        assert steps * step == pytest.approx(tree.durations[node])
        end = advance(pipeline.model, data, pipeline.space, full.controls[nodes[node]], steps)
        np.testing.assert_allclose(end, tree.states[node], atol=1e-9)


def test_plans_are_the_same_with_and_without_trees(tmp_path: Path) -> None:
    for name, config in (("without", QUICK), ("with", KEEP)):
        plan_into(CARTPOLE, tmp_path / name, num=1, seed=0, config=config, workers=0)
    shards = [(tmp_path / name / "shard-00000.safetensors").read_bytes() for name in ("without", "with")]
    assert shards[0] == shards[1]
    assert not (tmp_path / "without" / "trees").exists()
    assert "tree" not in (tmp_path / "without" / "manifest.json").read_text()
    trees = load_demos(tmp_path / "with").trees
    assert len(trees) == 1 and 1 < len(trees[0]) <= 100
    with pytest.raises(ps.PlanspaceError, match=r"config\.keep_trees was not set, now True"):
        plan_into(CARTPOLE, tmp_path / "without", num=3, seed=0, config=KEEP, workers=0)


@pytest.mark.slow
def test_interrupted_planning_keeps_the_same_trees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, calls = Pipeline.plan, []
    plan_into(CARTPOLE, tmp_path / "alone", num=3, seed=0, config=KEEP, workers=0)

    def interrupted(*args: Any):
        calls.append(args[-1])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return plan(*args)

    monkeypatch.setattr(Pipeline, "plan", interrupted)
    for _ in range(2):
        try:
            plan_into(CARTPOLE, tmp_path / "demos", num=3, seed=0, config=KEEP, workers=0)
        except KeyboardInterrupt:
            assert len(load_demos(tmp_path / "demos").trees) == 2
    assert calls == [0, 1, 2, 2]
    assert load_demos(tmp_path / "demos").hash == load_demos(tmp_path / "alone").hash


@pytest.mark.slow
def test_the_command_keeps_trees(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "demos")
    quick = ["--extensions", "64", "--restarts", "1", "--no-polish", "--workers", "2"]
    command = ["plan", "cartpole", "--num", "2", *quick, "--keep-trees", "--tree-nodes", "100", "--out", out]
    assert main(command) == 0
    assert main(command) == 0  # nothing is left to do
    expected = ps.plan_demos(CARTPOLE, 2, config=KEEP, workers=1, verbose=False)
    assert load_demos(out).hash == expected.hash
    capsys.readouterr()
    assert main(["demos", "show", out]) == 0
    assert "search_trees" in capsys.readouterr().out
    more = [*command[:3], "3", "--config", f"{out}/manifest.json", "--workers", "2", "--out", out]
    assert main(more) == 0  # the manifest holds all settings
    assert len(load_demos(out).trees) == 3


class Sees:
    """SST with another tree, or none."""

    def __init__(self, tree: Any):
        self.tree = tree

    def plan(self, query: Any, rng: Any) -> Plan | Failure:
        found = SST(extensions=64).plan(query, rng)
        return replace(found, tree=self.tree(query.start) if callable(self.tree) else self.tree)


def line(start: np.ndarray) -> SearchTree:
    """A tree of two nodes."""
    return SearchTree(np.stack([start, start + 1.0]), np.array([-1, 0]), np.array([0.0, 0.5]))


def test_a_users_planner_gives_its_tree() -> None:
    config = replace(KEEP, planner=Sees(line))
    (tree,) = ps.plan_demos(CARTPOLE, 1, config=config, workers=0, verbose=False).trees
    assert tree.times.tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (None, "returned no search tree; plan without keep_trees"),
        (lambda start: line(start + 1.0), r"must return a tree whose node 0 is query\.start"),
        (lambda start: line(start[:2]), r"must have states of shape \(2, 4\)"),
    ],
)
def test_what_is_not_a_tree_is_refused(tree: Any, message: str) -> None:
    with pytest.raises(UsageError, match=f"Planner {__name__}:Sees.*{message}.*own-planner.md"):
        ps.plan_demos(CARTPOLE, 1, config=replace(KEEP, planner=Sees(tree)), workers=0, verbose=False)


def test_the_bound_is_checked() -> None:
    with pytest.raises(UsageError, match="`tree_nodes` must be at least 1, got 0"):
        PlanConfig(tree_nodes=0)
