import sys
from types import ModuleType, SimpleNamespace

import pytest
from tqdm.notebook import tqdm_notebook

from planspace import progress as module
from planspace.progress import progress, progress_over, progress_shown


def run_stage() -> None:
    with progress("plan", total=4, done=1, unit="plan") as bar:
        bar.update(3)
        bar.set_postfix_str("return 12")


def test_a_log_has_one_line_for_a_short_stage(capsys: pytest.CaptureFixture[str]) -> None:
    run_stage()
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert lines[0].startswith("plan: 1/4") and lines[-1].startswith("plan: 4/4")


@pytest.mark.parametrize("is_terminal", [False, True])
def test_the_time_left_of_the_bar_can_be_hidden(
    is_terminal: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    for remaining in (True, False):
        with progress("study", total=4, remaining=remaining) as bar:
            bar.set_postfix_str("2 h left")
        shown = capsys.readouterr().err
        assert "2 h left" in shown and ("<" in shown) == remaining


@pytest.mark.parametrize(("outer", "inner"), [(False, False), (False, True), (True, False)])
def test_verbose_false_hides_every_bar(
    outer: bool, inner: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(module, "PATIENCE_S", 0.0)
    with progress_shown(outer), progress_shown(inner):
        run_stage()
        assert list(progress_over([1, 2], "read", unit="shard")) == [1, 2]
    assert capsys.readouterr().err == ""
    run_stage()  # shown again outside of the block
    assert "plan" in capsys.readouterr().err


def test_iterating_shows_a_bar_on_a_terminal_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PATIENCE_S", 0.0)
    assert list(progress_over("ab", "read", unit="shard")) == ["a", "b"]
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(progress_over("ab", "read", unit="shard")) == ["a", "b"]
    assert "read:   0%" in capsys.readouterr().err


def test_a_notebook_gets_the_bar_of_tqdm_auto(monkeypatch: pytest.MonkeyPatch) -> None:
    ipython = ModuleType("IPython")
    ipython.get_ipython = lambda: SimpleNamespace(config={"IPKernelApp": {}})  # pyright: ignore
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "tqdm.auto", SimpleNamespace(tqdm=tqdm_notebook))  # pyright: ignore
    assert module._bar() == (tqdm_notebook, {})
