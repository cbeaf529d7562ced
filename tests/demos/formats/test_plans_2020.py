import json
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
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
def test_other_deviations_from_json_are_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"plan_0\.json is not valid JSON"):
        load(tmp_path, text, info=None)
    assert not (tmp_path / "out").exists()


def test_times_that_increase_from_0_are_the_times_of_the_rows(tmp_path: Path) -> None:
    demos = load(tmp_path, plan([1, 10, 5, 0], [2, 20, 6, 0.1], [3, 30, 7, 0.3]))
    assert demos.times.tolist() == [0, 0.1, 0.3]
    assert demos.controls.tolist() == [[5], [6]]  # held from the state in its row on


def test_other_times_are_durations_of_the_controls(tmp_path: Path) -> None:
    demos = load(tmp_path, plan([1, 10, 5, 0.2], [2, 20, 6, 0.1], [3, 30, 7, 0.1]))
    np.testing.assert_allclose(demos.times, [0, 0.2, 0.3])
    assert demos.controls.tolist() == [[5], [6]]


def test_durations_that_start_with_0_belong_to_the_edge_before_the_row(tmp_path: Path) -> None:
    demos = load(tmp_path, plan([1, 10, 0, 0], [2, 20, 6, 0.2], [3, 30, 7, 0.1]))
    np.testing.assert_allclose(demos.times, [0, 0.2, 0.3])
    assert demos.controls.tolist() == [[6], [7]]


def test_one_bad_clock_among_good_ones_is_an_error(tmp_path: Path) -> None:
    good, bad = plan([1, 1, 1, 0], [1, 1, 1, 0.1]), plan([1, 1, 1, 0], [1, 1, 1, 0.1], [1, 1, 1, 0.1])
    with pytest.raises(PlanspaceError, match=r"plan_2\.json, row 2 of path: the time 0\.1 does not come"):
        load(tmp_path, good, good, bad)


def test_files_are_sorted_by_number(tmp_path: Path) -> None:
    demos = load(tmp_path, *[plan([i, 0, 0, 0], [i, 0, 0, 1]) for i in range(11)], info=None)
    assert demos.states[::2, 0].tolist() == list(range(11))  # plan_10 comes last, not third


def test_angles_keep_their_full_turns(tmp_path: Path) -> None:
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
        (plan([1, 2, 3, 0], [1, 2, 3]), "row 1 of path has 3 numbers, but state_dims has 4 names"),
        (plan([1, 2, 3, 0], [1, "2", 3, 1]), "row 1 of path contains '2', which is not a finite number"),
        (plan([1, 2, 3, 0], [1, True, 3, 1]), "row 1 of path contains True, which is not a finite number"),
        (plan([1, 2, 3, 0]), "must have a list 'path' of at least two rows"),
        (plan([1, 2, 3, 0], [1, 2, 3, 1], dims=["angl", "anglevel", "control1", "time"]), "mean 'angl'"),
        ("[]", "must contain a JSON object, got a list"),
        ("{}", "must have a list of names 'state_dims'"),
    ],
)
def test_errors_name_the_row_of_the_path(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=message) as caught:
        load(tmp_path, text)
    assert "plan_0.json" in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("first", ["1 10 0 0", "1 10", "1 10 9 9 "])
def test_rows_of_ompl_are_states_at_the_end_of_edges(first: str, tmp_path: Path) -> None:
    demos = load(tmp_path, f"{first}\n2 20 6 0.2 \r\n\n3 30 7 0.1", suffix=".out")
    np.testing.assert_allclose(demos.times, [0, 0.2, 0.3])
    assert demos.states.tolist() == [[1, 10], [2, 20], [3, 30]]
    assert demos.controls.tolist() == [[6], [7]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 10 0 0\n2 20 6\n", "plan_0.out, line 2 has 3 numbers; expected 2 of a state, 1 of a control"),
        ("1 10 0 0\n2 20 six 0.1\n", "plan_0.out, line 2 contains 'six'"),
        ("1 10 0 0\n2 20 6 0\n", "plan_0.out, line 2: the time 0 does not come after 0"),
        ("1 10 0 0\n", "plan_0.out has 1 states"),
    ],
)
def test_errors_name_the_line_of_an_out_file(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, text, suffix=".out")
    assert not (tmp_path / "out").exists()


def test_an_out_file_needs_a_problem(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="give --problem"):
        load(tmp_path, "1 10 0 0\n2 20 6 0.2\n", suffix=".out", info=None)


def test_a_string_without_end_is_scanned_once(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"plan_0\.json is not valid JSON"):
        load(
            tmp_path, '{"state_dims": "' + '\\"' * 300_000
        )  # scanning from every quotation mark would take hours
