"""The table that an import prints before it writes anything: what each column of the source is used for."""

from collections.abc import Sequence

import numpy as np

from planspace.demos.declare import Meaning
from planspace.demos.recording import Imported, Use
from planspace.demos.survey import Survey
from planspace.errors import printable

HEADER = ("column", "kind", "unit", "range", "why")
SLOW_STEP = 5.0
"""A robot is rarely recorded in longer steps [s]; the unit of the time may be another."""
MAX_ROWS = 200
"""Number of columns of the source that are printed."""
MAX_WIDTH = 40
"""Most characters in a cell of any column except the last."""


def import_table(imported: Imported, meaning: Meaning, survey: Survey, num_demos: int) -> str:
    """Return the table, with one row for each column of the source.

    Args:
        imported: the source.
        meaning: what its states mean.
        survey: statistics of its states and controls.
        num_demos: number of demonstrations.
    """
    uses = imported.uses or _uses(imported)
    rows = [_row(use, imported, meaning, survey, num_demos) for use in uses[:MAX_ROWS]]
    lines = _aligned([HEADER, *rows])
    if len(uses) > MAX_ROWS:
        lines.append(f"... and {len(uses) - MAX_ROWS} more columns")
    return "\n".join(lines)


def _uses(imported: Imported) -> list[Use]:
    """The states and controls of a source that is not a table."""
    info = imported.info
    states = [Use(name, "state", index=i) for i, name in enumerate(info.names)]
    return [Use("time", "time", "s"), *states] + [
        Use(f"control{i + 1}", "control", index=i) for i in range(info.num_controls)
    ]


def _row(
    use: Use, imported: Imported, meaning: Meaning, survey: Survey, num_demos: int
) -> tuple[str, str, str, str, str]:
    kind, unit, found, why = use.kind, use.unit, "", use.note
    if kind == "time":
        found = f"up to {survey.longest:.4g} s"
        if survey.average_duration > SLOW_STEP:
            slow = f"steps of {survey.average_duration:.4g} s; --unit {use.name}=ms?"
            why = "; ".join(filter(None, (why, slow)))
    elif kind == "episode":
        found = f"{num_demos} demonstrations"
    elif kind == "control":
        found = _range(survey.control_low[use.index], survey.control_high[use.index])
    elif kind == "state":
        found = _range(survey.low[use.index], survey.high[use.index])
        name = imported.info.names[use.index]
        if use.index not in meaning.columns:
            return use.name, "unused", unit, found, "--drop"
        place = meaning.columns.index(use.index)
        kind, unit = _state_kind(meaning, place), meaning.info.units[place]
        renamed = f"the state {name}" if name != use.name else ""
        why = "; ".join(filter(None, (renamed, meaning.notes[place] or why, _looks(survey, use.index, name))))
    return use.name, kind, unit, found, why


def _state_kind(meaning: Meaning, place: int) -> str:
    if place in meaning.info.circular_columns:
        return "angle"
    for first in meaning.info.quaternion_columns:
        if first <= place < first + 4:
            return f"quaternion {'wxyz'[place - first]}"
    return "state"


def _looks(survey: Survey, column: int, name: str) -> str:
    """What is suspicious about a state."""
    if survey.constant[column]:
        return f"constant; --drop {name}?"
    if survey.locked[column]:
        return "constant in each demonstration"
    return f"rises evenly, like a clock; --time or --drop {name}?" if survey.clocks[column] else ""


def _range(low: float, high: float) -> str:
    return f"{low:.4g} to {high:.4g}" if np.isfinite(low) else ""


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    cells = [[*map(_short, row[:-1]), row[-1]] for row in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(HEADER))]
    lines = ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)) for row in cells]
    return [line.rstrip() for line in lines]


def _short(text: str) -> str:
    text = printable(text)
    return text if len(text) <= MAX_WIDTH else f"{text[: MAX_WIDTH - 3]}..."
