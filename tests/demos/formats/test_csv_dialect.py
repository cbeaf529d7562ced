"""Text files with other delimiters, without a header, with comments and with decimal commas."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.convert import import_demos
from planspace.demos.dataset import Demos
from planspace.demos.load import load_demos
from planspace.demos.recording import ImportOptions
from planspace.errors import PlanspaceError

ROWS = [[0.0, 1.5, -2.0], [0.1, 1.25, 3.0], [0.2, 1.0, 4.5]]


def load(tmp_path: Path, text: str, name: str = "a.csv", **options) -> Demos:
    (tmp_path / name).write_text(text)
    import_demos([str(tmp_path / name)], tmp_path / "out", None, ImportOptions(**options))
    return load_demos(tmp_path / "out")


def written(delimiter: str, mark: str = ".", header: str = "time x v") -> str:
    rows = [delimiter.join(str(number).replace(".", mark) for number in row) for row in ROWS]
    return "\n".join([*([header.replace(" ", delimiter)] if header else []), *rows])


@pytest.mark.parametrize(
    ("delimiter", "mark", "name"),
    [
        (",", ".", ""),
        (";", ".", "semicolons"),
        (";", ",", "semicolons"),
        ("\t", ".", "tabs"),
        ("\t", ",", "tabs"),
        ("|", ".", "vertical bars"),
        (" ", ".", "white space"),
        ("   ", ",", "white space"),
        (", ", ".", ""),
    ],
)
@pytest.mark.parametrize("has_header", [True, False])
def test_delimiters_and_decimal_marks_are_found(
    delimiter: str, mark: str, name: str, has_header: bool, tmp_path: Path, capsys
) -> None:
    text = written(delimiter, mark, "time x v" if has_header else "")
    options = {} if has_header else {"time": "0", "states": {"x": "1", "v": "2"}}
    demos = load(tmp_path, text, **options)
    assert demos.info.names == ("x", "v")
    assert np.column_stack([demos.times, demos.states]).tolist() == ROWS
    notices = capsys.readouterr().err
    assert (f"a.csv: the columns are separated by {name}." in notices) == bool(name)
    assert ("the decimal mark is a comma" in notices) == (mark == ",")
    assert ("has no header: its columns are named column0 to column2" in notices) != has_header


def test_a_file_with_the_suffix_tsv_is_read(tmp_path: Path) -> None:
    assert load(tmp_path, written("\t"), "a.tsv").states.tolist() == [row[1:] for row in ROWS]


def test_columns_are_chosen_by_number_in_files_with_names(tmp_path: Path) -> None:
    demos = load(tmp_path, "clock,7,u\n0,1,2\n1,3,4\n", states={"x": "7"}, controls={"u": "2"}, time="0")
    assert (demos.states.tolist(), demos.controls.tolist()) == ([[1], [3]], [[2]])  # 7 is a name here


def test_a_file_without_header_needs_a_time(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"its columns are column0, column1.*--time NAME, or --dt"):
        load(tmp_path, "0.0,1\n0.1,2\n")
    assert load(tmp_path, "0.0,1\n0.1,2\n", dt=0.5).info.names == ("column0", "column1")


def test_the_header_of_numpys_savetxt_is_read(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.csv", ROWS, header="recorded today\ntime x v")
    assert load(tmp_path, (tmp_path / "a.csv").read_text()).info.names == ("x", "v")
    np.savetxt(tmp_path / "b.csv", ROWS, header="time,x,v", delimiter=",", comments="# ")
    text = (tmp_path / "b.csv").read_text()
    (tmp_path / "out").rename(tmp_path / "before")
    assert load(tmp_path, text, "b.csv").states.tolist() == [row[1:] for row in ROWS]


def test_lines_are_counted_with_comments(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"a\.csv, line 5: column 'x' must be a finite number, got 'y'"):
        load(tmp_path, "# by me\n\ntime,x\n0,1\n1,y\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,1,2\n0.1,3,4\n", "first row is '0 1 2', which may number the columns or be a state; write names"),
        ("t;x\n0,0;0,5\n0,1;0.7\n", "line 3: column 'x' has a decimal point in '0.7', but .* decimal commas"),
        (
            "t;x\n" + "".join(f"{i};{i}\n" for i in range(60)) + "60;0,5\n",
            "line 62: column 'x' has a decimal comma in '0,5', but the first rows of the file have none",
        ),
        ("t;x\n0;1\n1;2;3\n", "line 3 has 3 cells, but the header has 2"),
        ("# only a comment\n", "has no rows of numbers"),
    ],
)
def test_unclear_files_are_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path, text)
    assert not (tmp_path / "out").exists()


def semicolons(rows: list[tuple[int, float, float]]) -> str:
    return "episode;time;x\n" + "\n".join(f"{e};{t:.1f};{x:.2f}" for e, t, x in rows)


def spaces(rows: list[tuple[int, float, float]]) -> str:
    return "\n".join(f"{t:.1f} {x:.2f} {x:.2f}" for _, t, x in rows[:20])


def no_header(rows: list[tuple[int, float, float]]) -> str:
    return "\n".join(f"{t:.1f},{x:.2f},{x:.2f}" for _, t, x in rows[:20])


@pytest.mark.parametrize(
    ("write", "options", "shape"),
    [(semicolons, {}, (80, 1)), (spaces, {"time": "0"}, (20, 2)), (no_header, {"time": "0"}, (20, 2))],
)
def test_files_that_were_misread_before(
    write: Callable, options: dict, shape: tuple[int, int], tmp_path: Path
) -> None:
    rows = [(e, 0.1 * i, e + 0.1 * i) for e in range(4) for i in range(20)]
    demos = load(tmp_path, write(rows), **options)
    assert demos.states.shape == shape
    np.testing.assert_allclose(demos.states[:20, 0], 0.1 * np.arange(20), atol=1e-12)
    assert len(demos) == (4 if write is semicolons else 1)
