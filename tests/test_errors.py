import pickle

import pytest

from planspace.errors import LONGEST, PartialResult, PlanspaceError, UsageError, printable, quoted, unknown


@pytest.mark.parametrize("text", ["a plain line", "θ̇ of the Gelenk é", "数 Ω 🙂", "'quoted' \\ back"])
def test_what_can_be_seen_stays_as_it_is(text: str) -> None:
    assert printable(text) == text == str(PlanspaceError(text))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[2J", r"\x1b[2J"),
        ("a\nb\r\tc", r"a\nb\r\tc"),
        ("\x9b31m", r"\x9b31m"),  # one byte that some terminals take for ESC [
        ("\u202etxt.exe", r"\u202etxt.exe"),  # the rest would be written from right to left
        ("\udc80", r"\udc80"),  # of a file's name that is not UTF-8; it cannot even be printed
    ],
)
def test_what_cannot_be_seen_is_written_out(text: str, shown: str) -> None:
    assert printable(text) == shown == printable(shown)
    assert str(UsageError(f"in {text}.")) == f"in {shown}."


def test_a_message_of_any_length_keeps_its_beginning_and_its_end() -> None:
    text = str(PlanspaceError("begins" + "x" * 10**6 + "ends"))
    assert text.startswith("begins") and text.endswith("ends") and len(text) <= LONGEST + 5
    whole = "x" * LONGEST
    assert str(PlanspaceError(whole)) == whole


def test_a_quoted_value_is_short_whatever_it_is() -> None:
    assert quoted("carpole") == "'carpole'" and quoted([1, 2]) == "[1, 2]"
    for value in ("x" * 10**5, list(range(10**5)), [["x" * 99] * 99] * 99, {"x" * 99: {1: 2}}, 10**4000):
        assert len(quoted(value)) < 600
    assert len(str(unknown("task", "x" * 10**5, ["cartpole"]))) < 200


def test_an_error_comes_out_of_another_process_as_it_was() -> None:
    error = pickle.loads(pickle.dumps(PartialResult("\x1b " + "x" * 9999)))
    assert isinstance(error, PartialResult) and error.args == ("\x1b " + "x" * 9999,)
