import json
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos, StateInfo
from planspace.demos.folder import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError, UsageError

INFO = StateInfo(("angle", "anglevel"), ("rad", "rad/s"), (0,), 1)
DIMS = ["angle", "anglevel", "control1", "time"]


def load(tmp_path: Path, *texts: str, suffix: str = ".json", info: StateInfo | None = INFO) -> Demos:
    folder = tmp_path / "plans"
    folder.mkdir(exist_ok=True)
    for i, text in enumerate(texts):
        (folder / f"plan_{i}{suffix}").write_text(text)
    import_demos([str(folder)], tmp_path / "out", info, ImportOptions(as_recorded=True))
    return load_demos(tmp_path / "out")


def plan(*rows: list[float], dims: list[str] = DIMS) -> str:
    return json.dumps({"state_dims": dims, "path": list(rows)})


def test_trailing_commas_are_read_and_commas_in_names_are_kept(tmp_path: Path) -> None:
    text = '{"state_dims": ["a,]", "b\\",}", "time",], "path": [[1, 2, 0,], [3, 4, 0.5 ,\n ],\n],\n}'
    demos = load(tmp_path, text, info=None)
    assert demos.info.names == ("a,]", 'b",}')
    assert demos.states.tolist() == [[1, 2], [3, 4]]
    assert demos.times.tolist() == [0, 0.5]


@pytest.mark.parametrize(
    "text",
    [
        '{"state_dims": ["x", "time"], "path": [[0, 0], [1, 1],,]}',
        '{"state_dims": ["x", "time"], "path": [,]}',
        '{"state_dims": ["x", "time"], "path": [[0, 0], [1 1]]}',
        '{"state_dims": ["x", "time"], "path": [[0, 0], [NaN, 1]]}',
        "{'state_dims': ['x', 'time'], 'path': [[0, 0], [1, 1]]}",
        '{"state_dims": ["x", "time"], "path": [[0, 0], [1, 1]]} # plan',
    ],
)
def test_nothing_else_that_is_not_json_is_read(text: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"plan_0\.json is not valid JSON"):
        load(tmp_path, text, info=None)
    assert not (tmp_path / "out").exists()


def test_a_time_that_rises_from_0_is_the_moment_of_the_row(tmp_path: Path) -> None:
    demos = load(tmp_path, plan([1, 10, 5, 0], [2, 20, 6, 0.1], [3, 30, 7, 0.3]))
    assert demos.times.tolist() == [0, 0.1, 0.3]
    assert demos.controls.tolist() == [[5], [6]]  # held from its row on


def test_a_time_that_does_not_rise_is_the_duration_of_the_rows_control(tmp_path: Path) -> None:
    demos = load(tmp_path, plan([1, 10, 5, 0.2], [2, 20, 6, 0.1], [3, 30, 7, 0.1]))
    np.testing.assert_allclose(demos.times, [0, 0.2, 0.3])
    assert demos.controls.tolist() == [[5], [6]]


def test_durations_of_which_the_first_is_0_belong_to_the_edge_that_led_to_the_row(tmp_path: Path) -> None:
    demos = load(tmp_path, plan([1, 10, 0, 0], [2, 20, 6, 0.2], [3, 30, 7, 0.1]))
    np.testing.assert_allclose(demos.times, [0, 0.2, 0.3])
    assert demos.controls.tolist() == [[6], [7]]


def test_one_bad_clock_among_good_ones_is_an_error_and_no_duration(tmp_path: Path) -> None:
    good, bad = plan([1, 1, 1, 0], [1, 1, 1, 0.1]), plan([1, 1, 1, 0], [1, 1, 1, 0.1], [1, 1, 1, 0.1])
    with pytest.raises(PlanspaceError, match=r"plan_2\.json, row 2 of its path: the time 0\.1 does not come"):
        load(tmp_path, good, good, bad)


def test_plans_are_numbered_in_numerical_order(tmp_path: Path) -> None:
    demos = load(tmp_path, *[plan([i, 0, 0, 0], [i, 0, 0, 1]) for i in range(11)], info=None)
    assert demos.states[::2, 0].tolist() == list(range(11))  # plan_10 is the last, not the third


def test_wound_up_angles_stay_as_recorded(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text(plan([6, 1, 0, 0], [8, 1, 0, 1]))
    import_demos([str(tmp_path / "plan.json")], tmp_path / "out", INFO, ImportOptions())
    assert load_demos(tmp_path / "out").states[:, 0].tolist() == [6, 8]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            plan([1, 2, 3], [1, 2, 3], dims=["angle", "anglevel", "control1"]),
            "no 'time' among its state_dims",
        ),
        (plan([1, 2, 3, 0], [1, 2, 3]), "row 1 of its path has 3 numbers; state_dims names 4"),
        (plan([1, 2, 3, 0], [1, "2", 3, 1]), "row 1 of its path holds '2', which is no finite number"),
        (plan([1, 2, 3, 0], [1, True, 3, 1]), "row 1 of its path holds True, which is no finite number"),
        (plan([1, 2, 3, 0]), "no list 'path' of at least two rows"),
        (plan([1, 2, 3, 0], [1, 2, 3, 1], dims=["angl", "anglevel", "control1", "time"]), "mean 'angl'"),
        ("[]", "should hold a JSON object, got a list"),
        ("{}", "no list of names 'state_dims'"),
    ],
)
def test_bad_plans_are_refused_with_the_place(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=message) as caught:
        load(tmp_path, text)
    assert "plan_0.json" in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("first", ["1 10 0 0", "1 10", "1 10 9 9 "])
def test_rows_of_ompl_are_the_ends_of_edges(first: str, tmp_path: Path) -> None:
    demos = load(tmp_path, f"{first}\n2 20 6 0.2 \r\n\n3 30 7 0.1", suffix=".out")
    np.testing.assert_allclose(demos.times, [0, 0.2, 0.3])
    assert demos.states.tolist() == [[1, 10], [2, 20], [3, 30]]
    assert demos.controls.tolist() == [[6], [7]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 10 0 0\n2 20 6\n", "plan_0.out, line 2 has 3 numbers; 2 of state, 1 of control"),
        ("1 10 0 0\n2 20 six 0.1\n", "plan_0.out, line 2 holds 'six'"),
        ("1 10 0 0\n2 20 6 0\n", "plan_0.out, line 2: the time 0 does not come after 0"),
        ("1 10 0 0\n", "plan_0.out has 1 states"),
    ],
)
def test_bad_rows_of_ompl_are_refused_with_the_place(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, text, suffix=".out")
    assert not (tmp_path / "out").exists()


def test_rows_of_ompl_need_a_problem(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="give --problem"):
        load(tmp_path, "1 10 0 0\n2 20 6 0.2\n", suffix=".out", info=None)


def test_a_text_without_end_is_looked_through_once(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"plan_0\.json is not valid JSON"):
        load(tmp_path, '{"state_dims": "' + '\\"' * 300_000)  # would take hours from each quotation mark on
