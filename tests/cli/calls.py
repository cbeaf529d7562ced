"""Calling the command line in this process."""

import re

import pytest

from planspace.cli import main


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def unboxed(err: str) -> str:
    """The text inside tyro's box, on one line."""
    return " ".join(re.sub(r"[╭╮╰╯─│•]|-{3,}", " ", err).split())
