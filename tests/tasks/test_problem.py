import importlib
import linecache
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.assets import ASSETS
from planspace.physics.simulator import Simulator
from planspace.plan.config import PlanConfig
from planspace.plan.demonstrations import plan_into
from planspace.plan.ompl.planners import OMPL
from planspace.plan.sst import SST
from planspace.tasks.problem import Box
from planspace.tasks.problem_file import load_problem, shipped_problems

GOOD = (ASSETS / "cartpole-swingup.yaml").read_text()


def write(folder: Path, text: str) -> str:
    (folder / "cartpole.xml").write_text((ASSETS / "cartpole.xml").read_text())
    path = folder / "mine.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize("name", shipped_problems())
def test_shipped_problems_load_and_start_in_bounds(name: str, rng: np.random.Generator) -> None:
    problem = load_problem(name)
    model, space = problem.compile()
    simulator = Simulator(model, space, 64, threads=1, validity=problem.validity)
    goal = problem.draw_goal(space, rng)
    starts = np.stack([problem.draw_start(simulator, rng) for _ in range(60)])
    assert simulator.valid_states(starts).all() and simulator.valid_states(goal.center[None]).all()
    assert not goal.reached(starts).all()


def test_a_copied_file_is_the_same_problem_with_another_name(tmp_path: Path) -> None:
    mine, shipped = load_problem(write(tmp_path, GOOD)), load_problem("cartpole-swingup")
    assert mine.name == "mine"
    assert (mine.source, mine.start, mine.goal) == (shipped.source, shipped.start, shipped.goal)


def test_a_random_goal_is_drawn_from_its_box(rng: np.random.Generator) -> None:
    goal = load_problem("reacher-random").goal
    drawn = np.stack([goal.sample(rng) for _ in range(50)])
    assert drawn[:, :2].std(axis=0).min() > 1.0
    assert (drawn[:, 2:] == 0).all()


def test_only_problems_with_new_keys_have_another_hash(tmp_path: Path) -> None:
    """A dataset records the hash of its problem, so problems of earlier versions keep theirs."""
    problem = load_problem("cartpole")
    assert problem.hash == "e7819ef0a08b9a8c1bce7787f9f6f6c82372cf13260f6ce62c7dcd4b5d5abdc2"
    named = load_problem(write(tmp_path, f"{GOOD}body_features: {{pole: 2}}\nlimit_slack: 0.1\n"))
    assert (named.body_features, named.limit_slack) == ((("pole", 2.0),), 0.1)
    hashes = {named.hash, replace(named, body_features=()).hash, replace(named, limit_slack=0.0).hash}
    assert len(hashes) == 3


def test_a_problem_made_in_python_is_checked_and_has_a_short_repr() -> None:
    problem = load_problem("cartpole-swingup")
    assert load_problem(problem) is problem
    assert load_problem(ASSETS / "cartpole-swingup.yaml") == problem
    assert repr(problem) == "Problem('cartpole-swingup', joints slider, hinge, planner sst)"
    with pytest.raises(PlanspaceError, match="problem cartpole-swingup: goal must have 4 numbers, got 1"):
        load_problem(replace(problem, goal=Box((0.0,), (0.0,))))
    with pytest.raises(PlanspaceError, match="the model moves the joint 'slider', which is not in joints"):
        load_problem(replace(problem, joints=("hinge",)))


def test_an_unknown_problem_suggests_the_nearest() -> None:
    with pytest.raises(
        UsageError, match="unknown problem 'cartpole-swngup'. Did you mean 'cartpole-swingup'"
    ):
        load_problem("cartpole-swngup")


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("tolerance:", "tolerence:", "unknown key 'tolerence'. Did you mean 'tolerance'"),
        ("tolerance: 0.1", "", "the key 'tolerance' is missing"),
        ("[slider, hinge]", "[slider, hing]", "unknown joint 'hing'. Did you mean 'hinge'"),
        ("model: cartpole.xml", "model: nowhere.xml", "cannot read .*nowhere.xml"),
        ("goal: [0.0, 0.0, 0.0, 0.0]", "goal: [0.0, 0.0]", "goal must have 4 numbers, got 2"),
        ("goal: [0.0,", "goal: [2.0,", "goal: 'slider' must lie between -1 and 1, got 2 to 2.* joint limits"),
        (
            "goal: [0.0, 0.0,",
            "goal: [0.0, 180,",
            "goal: 'hinge' is an angle in radians, and 28.6 turns are too",
        ),
        ("[slider, hinge]", "[slider, hinge, slider]", "joints: 'slider' comes twice"),
        (
            "tolerance: 0.1",
            "tolerance: 0.1\ngoal_weights: [0, 0, 0, 0]",
            "goal_weights are all 0, so that every",
        ),
        ("low: [-0.2,", "low: [0.9,", "a box needs low <= high"),
        ("goal: [0.0, 0.0, 0.0, 0.0]", "goal: up", "expected a list of numbers, got 'up'"),
        ("tolerance: 0.1", "tolerance: !!python/object/apply:os.getcwd []", "is not valid YAML"),
        ("tolerance: 0.1", "tolerance: [", "is not valid YAML"),
        ("goal: [0.0,", "goal: [.nan,", "expected finite numbers"),
        ("model: cartpole.xml", "model: ../cartpole.xml", "'../cartpole.xml', outside its folder"),
        ("tolerance: 0.1", "tolerance: 0.1\ncost: speed", "unknown cost 'speed'"),
        ("tolerance: 0.1", "tolerance: 0.1\nhold: maybe", "hold: expected true or false, got 'maybe'"),
        ("tolerance: 0.1", "tolerance: 0.1\nforbidden_contacts: some", "none, all, or a list of pairs"),
        (
            "tolerance: 0.1",
            "tolerance: 0.1\nforbidden_contacts: [[cart, floor]]",
            "unknown geom or body",
        ),
        ("tolerance: 0.1", "tolerance: 0.1\ngoal_weights: [1.0]", "goal_weights must have 4 numbers, got 1"),
        ("high: [0.2,", "hihg: [0.2,", "start: unknown key of a box 'hihg'. Did you mean 'high'"),
        ("start: {low: [-0.2, -3.14, -0.1, -0.1], ", "start: {", "start: the key 'low' is missing"),
        ("joints: [slider, hinge]", "joints: 5", "joints: expected a list of names, got 5"),
        ("goal: [0.0, 0.0, 0.0, 0.0]", "goal: [true, 0, 0, 0]", "goal: expected finite numbers, got True"),
        ("tolerance: 0.1", "tolerance: -1", "tolerance: must be positive, got -1"),
        ("tolerance: 0.1", "tolerance: '0.1'", "tolerance: expected finite numbers, got '0.1'"),
        ("tolerance: 0.1", "tolerance: 1" + 400 * "0", "tolerance: .*too large"),
        ("tolerance: 0.1", "tolerance: 1" + 5000 * "0", "is not valid YAML"),
        ("tolerance: 0.1", "tolerance: 2020-13-45", "is not valid YAML"),
        ("tolerance: 0.1", "tolerance: 0.1\ntolerance: 0.2", "the key 'tolerance' comes twice"),
        ("tolerance: 0.1", "tolerance: 0.1\nsettings: [1]", "settings: expected keys and values"),
        ("tolerance: 0.1", "tolerance: 0.1\nsettings: {1: 2}", "settings: expected keys and values"),
        ("tolerance: 0.1", "tolerance: 0.1\nposition_bounds: 3", "position_bounds: .*items"),
        (
            "tolerance: 0.1",
            "tolerance: 0.1\ngoal_weights: [-1, 1, 1, 1]",
            "goal_weights: weights must not be neg",
        ),
        ("tolerance: 0.1", "tolerance: 0.1\nbody_features: [pole]", "expected bodies with their weights"),
        ("tolerance: 0.1", "tolerance: 0.1\nlimit_slack: -1", "limit_slack: must be positive, got -1"),
        ("tolerance: 0.1", "tolerance: 0.1\nbody_features: {pole: 0}", "body_features: must be positive"),
        (
            "tolerance: 0.1",
            "tolerance: 0.1\nbody_features: {poel: 1}",
            "unknown body in body_features 'poel'. Did you mean 'pole'",
        ),
        (
            "tolerance: 0.1",
            "tolerance: 0.1\nvelocity_bound: 0",
            "speeds must be positive, got 0",
        ),
        ("tolerance: 0.1", "tolerance: 0.1\nvelocity_bound: [1, 2, 3]", "the joints have 2 velocities"),
        (
            "tolerance: 0.1",
            "tolerance: 0.1\ncontrol_bounds: {low: [-4], high: [4]}",
            "within the model's own",
        ),
        ("tolerance: 0.1", "tolerance: 0.1\ncontrol_bounds: {low: [0], high: [0]}", "must have low < high"),
        ("tolerance: 0.1", "tolerance: 0.1\ncontrol_bounds: [1, 2]", "has 2 numbers; the model has 1 act"),
    ],
)
def test_bad_files_are_refused(before: str, after: str, message: str, tmp_path: Path) -> None:
    assert before in GOOD
    with pytest.raises(PlanspaceError, match=message):
        load_problem(write(tmp_path, GOOD.replace(before, after)))


def test_a_model_that_does_not_compile_is_reported_with_its_line(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD)
    (tmp_path / "cartpole.xml").write_text("<mujoco>\n<worldbody>\n<geom radius_='1'/></worldbody></mujoco>")
    with pytest.raises(PlanspaceError, match=r"cartpole.xml does not compile: .*radius_.*line 3"):
        load_problem(path)


FREE_SLIDER = """<mujoco><worldbody><body><joint name="x" type="slide"/><geom size="0.1"/></body></worldbody>
<actuator><motor name="push" joint="x"/></actuator></mujoco>"""


def test_a_joint_or_an_actuator_without_limits_needs_bounds(tmp_path: Path) -> None:
    path, text = (
        write(tmp_path, ""),
        "model: free.xml\njoints: [x]\nstart: [1, 0]\ngoal: [0, 0]\ntolerance: 0.1\n",
    )
    (tmp_path / "free.xml").write_text(FREE_SLIDER)
    Path(path).write_text(text)
    with pytest.raises(
        PlanspaceError, match="the actuator 'push' has no control range; .*give control_bounds"
    ):
        load_problem(path)
    text += "control_bounds: {low: [-1], high: [1]}\n"
    Path(path).write_text(text)
    with pytest.raises(PlanspaceError, match="'x' has no limits; give its joint position_bounds"):
        load_problem(path)
    Path(path).write_text(text + "position_bounds: {x: {low: [-2], high: [2]}}\n")
    model, space = load_problem(path).compile()
    assert space.high[0] == 2.0 and model.actuator_ctrlrange[0].tolist() == [-1, 1]


def test_joints_that_are_not_named_are_held(tmp_path: Path) -> None:
    short = GOOD.replace("joints: [slider, hinge]", "joints: [hinge]")
    for name, kept in (("start", "{low: [-3.14, -0.1], high: [3.14, 0.1]}"), ("goal", "[0.0, 0.0]")):
        short = "\n".join(f"{name}: {kept}" if line.startswith(name) else line for line in short.splitlines())
    short = "\n".join(x for x in short.splitlines() if not x.startswith(("feature", "sample")))
    with pytest.raises(PlanspaceError, match="has no actuator that moves these joints"):
        load_problem(write(tmp_path, short))


def test_a_goal_box_is_reached_anywhere_inside(tmp_path: Path) -> None:
    box = "goal: {low: [-0.5, -0.2, 0.0, 0.0], high: [0.5, 0.2, 0.0, 0.0]}"
    path = write(tmp_path, GOOD.replace("goal: [0.0, 0.0, 0.0, 0.0]", box))
    problem = load_problem(path)
    goal = problem.draw_goal(problem.compile()[1], np.random.default_rng(0))
    # x is 0.3 outside, theta 0.1 inside its box, xdot 0.5 off: 0.3 + 0 + 0.5
    assert goal.distance(np.array([0.8, -0.1, 0.5, 0.0])) == pytest.approx(0.8)
    assert goal.reached(np.array([[0.5, 0.2 - 2 * np.pi, 0.0, 0.0]])).all()


def test_the_layout_of_2020_is_read(tmp_path: Path) -> None:
    text = """
mujoco_config: cartpole.xml
planner: sst
sst_selection_radius: 0.002
sst_pruning_radius: 0.0005
start: [0.0, 0.0, 0.0, 0.0]
start_range: [0.2, 3.14, 0.1, 0.1]
goal: [0.0, 0.0, 0.0, 0.0]
time_limit: 30
"""
    problem, ours = load_problem(write(tmp_path, text)), load_problem("cartpole-swingup")
    assert (problem.joints, problem.start, problem.goal) == (ours.joints, ours.start, ours.goal)
    assert problem.tolerance == 0.1
    assert PlanConfig.for_problem(problem).planner == SST()
    wanted = OMPL("SST", seconds=30.0, selection_radius=0.002, pruning_radius=5e-4)
    assert PlanConfig.for_problem(problem, planner="ompl-sst").planner == wanted
    rrt = load_problem(write(tmp_path, text.replace("planner: sst", "planner: RRT")))
    assert problem.settings == rrt.settings and rrt.planner == "ompl-rrt"
    with pytest.raises(UsageError, match="unknown key 'time_limt'. Did you mean 'time_limit'"):
        load_problem(write(tmp_path, text.replace("time_limit", "time_limt")))


def test_starts_always_in_collision_are_reported(rng: np.random.Generator, tmp_path: Path) -> None:
    problem = load_problem("arm")
    inside_post = (0.0, 1.57, 0.0, 0.0, *[0.0] * 10)
    problem = replace(problem, start=Box(inside_post, inside_post))
    model, space = problem.compile()
    simulator = Simulator(model, space, 4, threads=1, validity=problem.validity)
    with pytest.raises(PlanspaceError, match="problem arm: no valid start in 1000 draws: .*collision"):
        problem.draw_start(simulator, rng)
    with pytest.raises(PlanspaceError, match="no valid start"):
        plan_into(problem, tmp_path / "demos", num=1, seed=0)
    assert not (tmp_path / "demos").exists()


def test_a_goal_in_collision_and_one_that_spans_rotations_are_refused(tmp_path: Path) -> None:
    arm = (ASSETS / "arm-kinematic.yaml").read_text()
    (tmp_path / "arm.xml").write_text((ASSETS / "arm.xml").read_text())
    (tmp_path / "mine.yaml").write_text(arm.replace("goal: [1.0, 0.8,", "goal: [0.0, 1.57,"))
    with pytest.raises(PlanspaceError, match="goal: it is in collision"):
        load_problem(str(tmp_path / "mine.yaml"))
    ball = (ASSETS / "ball-pendulum.yaml").read_text()
    (tmp_path / "ball-pendulum.xml").write_text((ASSETS / "ball-pendulum.xml").read_text())
    box = "goal: {low: [0.7, 0, 0, 0, 0, 0, 0], high: [1, 0, 0, 0, 0, 0, 0]}"
    (tmp_path / "mine.yaml").write_text(ball.replace("goal: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]", box))
    with pytest.raises(PlanspaceError, match="goal: a box cannot span rotations"):
        load_problem(str(tmp_path / "mine.yaml"))


def test_a_goal_box_on_a_circle_behind_a_ball_stays_on_the_circle() -> None:
    """The hinge is number 4 of a state and number 3 of a tangent."""
    mjcf = """<mujoco><compiler angle="radian"/><worldbody>
      <body><joint name="b" type="ball"/><geom size="0.1"/>
        <body><joint name="h"/><geom size="0.1"/></body></body></worldbody>
      <actuator><motor joint="h" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""
    low = (1.0, 0.0, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0, 0.0)
    high = (*low[:4], 3.0, *low[5:])
    problem = replace(load_problem("pendulum"), model=mjcf, joints=("b", "h"), goal=Box(low, high))
    goal = problem.draw_goal(problem.compile()[1], np.random.default_rng(0))
    inside = np.array([1.0, 0, 0, 0, 2.9, 0, 0, 0, 0])
    assert goal.distance(inside) == pytest.approx(0.0, abs=1e-12)
    assert goal.distance(inside + np.eye(9)[4] * 0.241592653589793) == pytest.approx(0.141592653589793)


def test_messages_stay_short_for_aliased_and_nested_yaml(tmp_path: Path) -> None:
    aliases = "[&a [1, 1, 1], &b [*a, *a, *a], &c [*b, *b, *b], &d [*c, *c, *c], &e [*d, *d, *d], [*e, *e]]"
    text = GOOD.replace("tolerance: 0.1", f"tolerance: {aliases}")
    deep = "[" * 40 + "1" + "]" * 40
    with pytest.raises(PlanspaceError, match="tolerance: expected finite numbers") as raised:
        load_problem(write(tmp_path, text))
    assert len(str(raised.value)) < 300
    with pytest.raises(PlanspaceError, match="tolerance: expected finite numbers") as raised:
        load_problem(write(tmp_path, GOOD.replace("tolerance: 0.1", f"tolerance: {deep}")))
    assert len(str(raised.value)) < 300


class Fence:
    """A predicate as a method, with a setting."""

    def __init__(self, reach: float) -> None:
        self.reach = reach

    def inside(self, states: np.ndarray) -> np.ndarray:
        return np.abs(states[:, 0]) < self.reach


PREDICATE = """
REACH = 0.5

def size(states):
    return abs(states[:, 0])

def allowed(states):
    return size(states) < REACH
"""


def test_a_changed_predicate_changes_the_hash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = load_problem("cartpole")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)

    def hash_of(text: str) -> str:
        (tmp_path / "own_predicate.py").write_text(text)
        sys.modules.pop("own_predicate", None)
        linecache.clearcache()
        return replace(problem, predicate=importlib.import_module("own_predicate").allowed).hash

    first = hash_of(PREDICATE)
    changes = (
        ("<", "<="),
        ("0.5", "0.6"),
        ("states[:, 0]", "states[:, 1]"),
    )  # its code, what it reads and calls
    hashes = {hash_of(PREDICATE.replace(*change)) for change in changes}
    assert len({problem.hash, first} | hashes) == 5
    assert hash_of(PREDICATE) == first == hash_of(f"{PREDICATE}OTHER = 1\n")
    near, far = (replace(problem, predicate=Fence(reach).inside).hash for reach in (0.5, 0.6))
    assert near != far and near == replace(problem, predicate=Fence(0.5).inside).hash


def allowed_anywhere(states: np.ndarray) -> np.ndarray:
    return np.ones(len(states), dtype=bool)


def test_a_changed_predicate_does_not_continue_a_dataset(tmp_path: Path) -> None:
    out, config = tmp_path / "demos", PlanConfig.for_problem(load_problem("cartpole"), restarts=1)
    problem = replace(load_problem("cartpole"), predicate=allowed_anywhere)
    assert plan_into(problem, out, num=1, seed=0, config=config, workers=1).num_episodes == 1
    assert plan_into(problem, out, num=1, seed=0, config=config, workers=1).num_episodes == 1
    with pytest.raises(PlanspaceError, match="problem"):
        plan_into(replace(problem, predicate=Fence(5.0).inside), out, num=2, seed=0, config=config, workers=1)
