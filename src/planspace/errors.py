"""What planspace raises at its borders; the command line turns each into one line and an exit code."""

import difflib
import reprlib
from collections.abc import Iterable
from typing import Any

LONGEST = 2500
"""Characters of a message; our own lists of names, such as a study's arms, are shorter."""
_SHORT = reprlib.Repr()
_SHORT.maxlevel = 1  # of a list in a list it is said that there is one
_SHORT.maxstring = _SHORT.maxother = 80


class PlanspaceError(Exception):
    """Something failed; the message says what, where and what to do.

    Its text is one line of bounded length in which every character is to be seen, whatever names and values
    of a stranger's file it quotes.
    """

    exit_code = 1

    def __str__(self) -> str:
        """The message as it may be shown on a terminal."""
        text = printable(super().__str__())
        if len(text) <= LONGEST:
            return text
        half = LONGEST // 2
        return f"{text[:half]} ... {text[-half:]}"


class UsageError(PlanspaceError):
    """The caller asked for something that does not exist or does not fit together."""

    exit_code = 2


class PartialResult(PlanspaceError):
    """Part of the work was done and saved, part could not be."""

    exit_code = 3


def printable(text: str) -> str:
    """The text with each character that is not to be seen, such as ESC or an end of line, written out."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def quoted(value: Any) -> str:
    """A value as a message quotes it: its `repr`, shortened in the middle where it is long."""
    return _SHORT.repr(value)


def unknown(kind: str, name: Any, known: Iterable[str]) -> UsageError:
    """Builds the error for a name that is not in a closed list, with the nearest name that is.

    Args:
        kind: what the name should have named, for example `"task"`.
        name: the name that was given.
        known: the names that exist.

    Returns:
        The error, to be raised by the caller.
    """
    names = sorted(known)
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.4)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return UsageError(f"unknown {kind} {quoted(name)}.{hint} Known: {', '.join(names)}.")
