"""The exceptions of planspace; the command line prints each as one line and returns its exit code."""

import difflib
import reprlib
from collections.abc import Iterable
from typing import Any

MAX_LENGTH = 2500
"""Largest number of characters in a message; our own lists of names, such as a study's arms, are shorter."""
_SHORT = reprlib.Repr()
_SHORT.maxlevel = 1  # a list inside a list is shown as [...]
_SHORT.maxstring = _SHORT.maxother = 80


class PlanspaceError(Exception):
    """A failure; the message says what happened, with which value, and what to do.

    The text is one line of bounded length without control characters, even if it quotes names and values
    from an untrusted file.
    """

    exit_code = 1

    def __str__(self) -> str:
        """The message, safe to print on a terminal."""
        text = printable(super().__str__())
        if len(text) <= MAX_LENGTH:
            return text
        half = MAX_LENGTH // 2
        return f"{text[:half]} ... {text[-half:]}"


class UsageError(PlanspaceError):
    """The caller asked for something that does not exist, or for values that do not fit together."""

    exit_code = 2


class PartialResult(PlanspaceError):
    """Part of the work was done and saved, the rest failed."""

    exit_code = 3


def printable(text: str) -> str:
    """Escape every character that is not printable, such as ESC or a newline."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def quoted(value: Any) -> str:
    """Return the `repr` of a value for a message, shortened in the middle if it is long."""
    return _SHORT.repr(value)


def check_setting(name: str, value: Any, fits: bool, wanted: str) -> None:
    """Check the value of a setting.

    Args:
        name: the setting.
        value: its value.
        fits: whether the value is allowed.
        wanted: what is allowed, for the message: `"at least 1"`.

    Raises:
        UsageError: the value does not fit.
    """
    if not fits:
        raise UsageError(f"`{name}` must be {wanted}, got {quoted(value)}.")


def unknown(kind: str, name: Any, known: Iterable[str]) -> UsageError:
    """Build the error for a name that does not exist, with the most similar name that does.

    Args:
        kind: what the name stands for, for example `"task"`.
        name: the name that was given.
        known: the names that exist.

    Returns:
        The error; the caller raises it.
    """
    names = sorted(known)
    hint = did_you_mean(str(name), names)
    return UsageError(f"unknown {kind} {quoted(name)}.{hint} Known: {', '.join(names)}.")


def did_you_mean(name: str, known: list[str]) -> str:
    """Return ` Did you mean ...?` with the most similar known name; empty if none is similar."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.55)
    return f" Did you mean {near[0]!r}?" if near else ""
