"""What planspace raises at its borders; the command line turns each into one line and an exit code."""

import difflib
from collections.abc import Iterable
from typing import Any


class PlanspaceError(Exception):
    """Something failed; the message says what, where and what to do."""

    exit_code = 1


class UsageError(PlanspaceError):
    """The caller asked for something that does not exist or does not fit together."""

    exit_code = 2


class PartialResult(PlanspaceError):
    """Part of the work was done and saved, part could not be."""

    exit_code = 3


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
    return UsageError(f"unknown {kind} {name!r}.{hint} Known: {', '.join(names)}.")
