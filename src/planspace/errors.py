"""The exceptions of planspace; the command line prints each as one line and returns its exit code."""

import difflib
import json
import numbers
import reprlib
import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

MAX_LENGTH = 2500
"""Largest number of characters in a message; our own lists of names, such as a study's arms, are shorter."""
MOST_UNITS = 16_384
"""Largest number of units of a hidden layer. Two layers of them have a GB of weights."""
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


def check_whole(name: str, value: Any, least: int = 1) -> None:
    """Check that a number is whole and not too small.

    Args:
        name: the argument or setting.
        value: its value.
        least: the smallest that is allowed.

    Raises:
        UsageError: it is not.
    """
    is_whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    check_setting(name, value, is_whole and int(value) >= least, f"a whole number of at least {least}")


def check_layers(name: str, layers: Sequence[int]) -> None:
    """Check the units of hidden layers.

    Args:
        name: the setting.
        layers: units of each layer.

    Raises:
        UsageError: there is no layer, or one has no units or more than `MOST_UNITS`.
    """
    if not layers or min(layers) < 1:
        raise UsageError(f"`{name}` needs at least one unit in each layer, got {quoted(tuple(layers))}.")
    check_setting(name, max(layers), max(layers) <= MOST_UNITS, f"at most {MOST_UNITS:,} units a layer")


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


def install_command(extra: str) -> str:
    """Return the command that installs an extra, for a message.

    It names the place that planspace was installed from (a folder, a file or a repository), so that it works
    in every folder, and before planspace is on a package index.

    Args:
        extra: an extra of pyproject.toml, such as `"ompl"`.
    """
    from urllib.parse import urlsplit
    from urllib.request import url2pathname  # slow to import, and only needed here

    origin = _origin()
    url = origin.get("url", "")
    if not url:
        return f"pip install 'planspace[{extra}]'"
    if repository := origin.get("vcs_info"):
        place = f"{repository['vcs']}+{url}@{repository['commit_id']}"
        return f"pip install {shlex.quote(f'planspace[{extra}] @ {place}')}"
    path = Path(url2pathname(urlsplit(url).path))
    if not path.exists():
        return f"pip install '.[{extra}]' in a checkout of planspace"
    option = "-e " if origin.get("dir_info", {}).get("editable") else ""
    return f"pip install {option}{shlex.quote(f'{path}[{extra}]')}"


def _origin() -> dict[str, Any]:
    """What planspace was installed from, as pip records it (PEP 610); empty for a package index."""
    from importlib.metadata import PackageNotFoundError, distribution

    root = Path(__file__).resolve().parents[2]
    if (root / "pyproject.toml").exists():
        return {"url": root.as_uri(), "dir_info": {"editable": True}}
    try:
        record = distribution("planspace").read_text("direct_url.json")
    except PackageNotFoundError:  # copied into a folder
        return {}
    return json.loads(record) if record else {}
