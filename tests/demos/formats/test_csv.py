from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import export_demos, import_demos
from planspace.demos.dataset import Demos
from planspace.demos.formats.columns import choose_columns
from planspace.demos.formats.format import Column
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from planspace.plan.demonstrations import state_info
from planspace.tasks.problem_file import load_problem

PLAIN = "time,x,v\n0,1,2\n0.1,3,4\n0.2,5,6\n"


def load(tmp_path: Path, *texts: str, info: StateInfo | None = None, **options) -> Demos:
    files = []
    for i, text in enumerate(texts):
        file = tmp_path / f"{i}.csv"
        file.write_bytes(text.encode())
        files.append(str(file))
    import_demos(files, tmp_path / "out", info, ImportOptions(**options))
    return load_demos(tmp_path / "out")


def test_export_and_import_are_exact(demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, str(tmp_path / "demos.csv"))
    import_demos([str(tmp_path / "demos.csv")], tmp_path / "back", demos.info, ImportOptions())
    back = load_demos(tmp_path / "back")
    for name in ("states", "controls", "times", "offsets"):
        np.testing.assert_array_equal(getattr(back, name), getattr(demos, name))
    assert back.info == demos.info


def test_the_last_row_of_a_demonstration_has_no_control(demos: Demos, tmp_path: Path) -> None:
    export_demos(demos, str(tmp_path / "demos.csv"))
    lines = (tmp_path / "demos.csv").read_text().splitlines()
    assert lines[0] == "episode,time,slider,hinge,slidervel,hingevel,control1"
    assert len(lines) == 1 + len(demos.states)
    assert sum(line.endswith(",") for line in lines) == len(demos)


def test_states_are_named_after_columns_without_a_problem(tmp_path: Path, capsys) -> None:
    demos = load(tmp_path, PLAIN)
    assert demos.info == StateInfo(("x", "v"), ("", ""), (), 0)
    assert demos.states.tolist() == [[1, 2], [3, 4], [5, 6]]
    assert demos.controls.shape == (2, 0)
    assert np.isnan(demos.goals).all() and not demos.success.any()
    assert "has no controls" in capsys.readouterr().err


def test_one_demonstration_per_file_or_per_value_of_the_column_episode(tmp_path: Path) -> None:
    assert len(load(tmp_path / "", PLAIN, PLAIN.replace("5", "7"))) == 2
    text = "episode,t,x,control0\nb,0,1,10\na,5,2,20\nb,1,3,\na,6,4,\n"
    (tmp_path / "sub").mkdir()
    demos = load(tmp_path / "sub", text)
    assert demos.episode(0).states.tolist() == [[1], [3]]  # in the order of their first rows
    assert demos.episode(1).states.tolist() == [[2], [4]]
    assert demos.times.tolist() == [0, 1, 0, 1]
    assert demos.controls.tolist() == [[10], [20]]


def test_windows_line_endings_byte_order_mark_and_quotes(tmp_path: Path) -> None:
    text = '\ufefftime,"cart, position",v\r\n0,"1",2\r\n\r\n0.1,"3",4\r\n'
    demos = load(tmp_path, text)
    assert demos.info.names == ("cart, position", "v")
    assert demos.states.tolist() == [[1, 2], [3, 4]]


CARTPOLE = "time,pos,hinge,slidervel,hingevel,{}\n0,1,5,3,4,9\n0.02,5,6,7,8,9\n"


@pytest.mark.parametrize("name", ["control1", "control0", "push", "force"])
def test_columns_are_found_by_the_names_of_the_problem_or_of_the_options(name: str, tmp_path: Path) -> None:
    info = state_info(load_problem("cartpole-swingup"))
    controls = {"push": "force"} if name == "force" else {}
    demos = load(tmp_path, CARTPOLE.format(name), info=info, states={"slider": "pos"}, controls=controls)
    assert demos.info.names == ("slider", "hinge", "slidervel", "hingevel")
    # the last angle, 6 rad, is shifted to 6 - 2 pi, and all others by the same amount
    np.testing.assert_allclose(demos.states, [[1, 5 - 2 * np.pi, 3, 4], [5, 6 - 2 * np.pi, 7, 8]])
    assert demos.controls.tolist() == [[9]]


def test_missing_controls_are_stored_as_zeros(tmp_path: Path, capsys) -> None:
    info = state_info(load_problem("cartpole-swingup"))
    demos = load(tmp_path, CARTPOLE.format("other"), info=info, states={"slider": "pos"})
    assert demos.controls.tolist() == [[0]]
    said = "the source has no controls: zeros are stored instead."
    assert capsys.readouterr().err.splitlines()[0] == said


def test_dt_replaces_a_time_column(tmp_path: Path) -> None:
    assert load(tmp_path, "x\n1\n2\n3\n", dt=0.5).times.tolist() == [0, 0.5, 1.0]


def test_named_states_choose_their_columns(tmp_path: Path) -> None:
    demos = load(tmp_path, PLAIN, states={"speed": "v"})
    assert demos.info.names == ("speed",)
    assert demos.states.tolist() == [[2], [4], [6]]


def test_uneven_steps_are_resampled_with_a_notice(tmp_path: Path, capsys) -> None:
    uneven = "time,x\n0,0\n0.1,1\n0.2,2\n0.5,5\n"
    demos = load(tmp_path, "time,x\n0,0\n0.1,1\n", uneven)
    np.testing.assert_allclose(demos.episode(1).times, [0, 0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(demos.episode(1).states[:, 0], [0, 1, 2, 3, 4, 5], atol=1e-12)
    assert "resampled 1 of 2 demonstrations to a step of 0.1 s" in capsys.readouterr().err
    (tmp_path / "sub").mkdir()
    assert load(tmp_path / "sub", uneven, as_recorded=True).times.tolist() == [0, 0.1, 0.2, 0.5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (PLAIN.replace("4", "nan"), r"0\.csv, line 3: column 'v' must be a finite number, got 'nan'"),
        (PLAIN.replace("4", "four"), r"0\.csv, line 3: column 'v' must be a finite number, got 'four'"),
        (PLAIN.replace("4", "1_0"), r"line 3: column 'v' must be a finite number, got '1_0'"),
        (PLAIN.replace("4", ""), r"0\.csv, line 3: column 'v' is empty"),
        (PLAIN + "0,1,2\n0.1,3,4\n", r"0\.csv, line 5: the time goes back from 0\.2 to 0 s.*--episode"),
        (PLAIN.replace("3,4", "3"), r"0\.csv, line 3 has 2 cells, but the header has 3"),
        (PLAIN.replace("time", "when"), r"0\.csv has no column with the name of a time.*Give --time NAME"),
        (PLAIN.replace("v", "x"), r"0\.csv has two columns named 'x'"),
        ("time,x\n0,1\n", r"1 demonstration has one state: left out \(.*0\.csv, line 2\)"),
        ("time\n0\n1\n", r"0\.csv has no column with a state; its columns are time"),
        ("", r"0\.csv has no rows of numbers"),
        ("time,x\n", r"0\.csv has a header, but no rows of numbers"),
        ('time,x\n0,"1\n', r"0\.csv is not a CSV file"),
        ("time,x,control1\n0,1,2\n1,2,\n2,3,4\n", r"line 3: column 'control1' is empty"),
    ],
)
def test_errors_name_the_line_and_column(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, text)
    assert not (tmp_path / "out").exists()


def test_text_that_is_not_utf_8_is_refused(tmp_path: Path) -> None:
    (tmp_path / "latin.csv").write_bytes(b"time,\xe9\n0,1\n1,2\n")
    with pytest.raises(PlanspaceError, match="latin.csv is not UTF-8 text"):
        import_demos([str(tmp_path / "latin.csv")], tmp_path / "out", None, ImportOptions())


def test_errors_suggest_a_similar_column(tmp_path: Path) -> None:
    info = state_info(load_problem("cartpole-swingup"))
    with pytest.raises(PlanspaceError, match=r"0\.csv: unknown column 'slider'. Did you mean 'slidr'\?"):
        load(tmp_path, CARTPOLE.format("u").replace("pos", "slidr"), info=info)
    with pytest.raises(PlanspaceError, match=r"0\.csv: unknown column 'poss'. Did you mean 'pos'\?"):
        load(tmp_path, CARTPOLE.format("u"), info=info, states={"slider": "poss"})
    with pytest.raises(UsageError, match=r"unknown state 'slidr'. Did you mean 'slider'\?"):
        load(tmp_path, CARTPOLE.format("u"), info=info, states={"slidr": "pos"})
    with pytest.raises(UsageError, match=r"unknown control 'pull'"):
        load(tmp_path, CARTPOLE.format("u"), info=info, states={"slider": "pos"}, controls={"pull": "u"})


def test_files_with_different_columns_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"1\.csv has the states \(x, w\).*0\.csv has \(x, v\)"):
        load(tmp_path, PLAIN, PLAIN.replace("v", "w"))


def test_a_state_named_like_another_column_is_not_exported(tmp_path: Path) -> None:
    demos = load(tmp_path, PLAIN, states={"time": "v"}, dt=0.1)
    with pytest.raises(PlanspaceError, match="the state 'time' has the name of another column"):
        export_demos(demos, str(tmp_path / "x.csv"))
    assert not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize("num", [10_001, pytest.param(200_000, marks=pytest.mark.nightly)])
def test_too_many_columns_are_refused(num: int, tmp_path: Path) -> None:
    names, row = ",".join(f"x{i}" for i in range(num)), ",".join(["0"] * num)
    with pytest.raises(PlanspaceError, match=rf"0\.csv has {num} columns; at most 10000 are allowed"):
        load(tmp_path, f"{names}\n{row}\n{row}\n")


def test_duplicated_columns_are_found_in_linear_time(tmp_path: Path) -> None:
    class Name(str):
        compared = 0
        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            Name.compared += 1
            return str.__eq__(self, other)

    choose_columns([Column(Name(f"x{i}")) for i in range(1000)], None, ImportOptions(), "x.csv")
    assert Name.compared < 10_000


def test_reading_stops_at_a_line_that_is_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planspace.demos.formats.csv.MAX_LINE", 100)
    load(tmp_path, PLAIN)
    with pytest.raises(PlanspaceError, match=r"0\.csv is not a CSV file \(a line has more than 100 char"):
        load(tmp_path, PLAIN + "1," * 50)
