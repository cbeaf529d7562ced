"""The answer of a study in a few plain sentences, for the top of its report."""

from collections.abc import Sequence

from planspace.study.stats import FAILS, HOLDS, OPEN
from planspace.study.tables import ArmRow, ClaimRow, StudySummary

FEW_SEEDS = 5
"""With fewer seeds than this, a study only shows that it works."""


def answer(summary: StudySummary) -> list[str]:
    """What was run, how many claims hold, the first claim, the best arm, and how far to trust all this.

    Args:
        summary: the tables of the study; at least one arm has results.

    Returns:
        At most five sentences, without markup.
    """
    rows = [row for panel in summary.panels.values() for row in panel]
    seeds = _span([row.seeds for row in rows])
    sentences = [
        f"{sum(row.seeds for row in rows)} policies were trained for {summary.steps_text} steps each: "
        f"{_counted(len(rows), 'arm')} with {_counted_span(seeds, 'seed')} each, in "
        f"{_counted(len(summary.panels), 'comparison')}."
    ]
    if judged := [claim for claim in summary.claims if claim.verdict in (HOLDS, FAILS, OPEN)]:
        sentences += [_verdicts(judged), _first(judged[0])]
    panel, arms = next(iter(summary.panels.items()))
    if len(arms) > 1:
        sentences.append(_best(panel, arms))
    return [*sentences, _trust(summary, min(row.seeds for row in rows), len(judged))]


def _verdicts(claims: Sequence[ClaimRow]) -> str:
    count = {verdict: sum(claim.verdict == verdict for claim in claims) for verdict in (HOLDS, FAILS, OPEN)}
    if count[OPEN] == len(claims):
        return f"These seeds are too few to decide any of the {_counted(len(claims), 'claim')}."
    hold = "holds" if count[HOLDS] == 1 else "hold"
    fail = "does" if count[FAILS] == 1 else "do"
    return (
        f"Of {_counted(len(claims), 'claim')}, {count[HOLDS]} {hold}, {count[FAILS]} {fail} not hold, and "
        f"{count[OPEN]} cannot be decided with these seeds."
    )


def _first(row: ClaimRow) -> str:
    said = {HOLDS: "holds", FAILS: "does not hold", OPEN: "is open"}[row.verdict]
    sentence = f"The first claim, “{row.claim.text}”, {said}"
    if row.number is None or row.interval is None:
        return f"{sentence}: {_counted(row.seeds, 'seed')} give no interval."
    low, high = row.interval
    return f"{sentence}: its number is {row.number:.2f} (95 % interval {low:.2f} to {high:.2f})."


def _best(panel: str, arms: Sequence[ArmRow]) -> str:
    first, best = arms[0], max(arms, key=lambda row: row.mean)
    start = f"In the first comparison ({panel}), {best.arm} has the highest mean return, {_estimate(best)}"
    return f"{start}." if best is first else f"{start}; {first.arm} has {_estimate(first)}."


def _estimate(row: ArmRow) -> str:
    low, high = row.mean_interval
    return f"{row.mean:.1f} ({low:.1f} to {high:.1f})"


def _trust(summary: StudySummary, seeds: int, judged: int) -> str:
    if summary.units_done < summary.units_all:
        done = f"{summary.units_done} of {summary.units_all} units are done"
        return f"The study is not finished: {done}, and the others can change this."
    if seeds < FEW_SEEDS:
        few = _counted(seeds, "seed")
        return f"With {few}, the study only shows that it works; a larger budget gives answers."
    claims = _counted(judged, "claim")
    return f"One interval in twenty misses the true value by chance, and {claims} were judged."


def _span(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low}" if low == high else f"{low} to {high}"


def _counted(number: int, noun: str) -> str:
    return _counted_span(f"{number}", noun)


def _counted_span(number: str, noun: str) -> str:
    return f"{number} {noun}" if number == "1" else f"{number} {noun}s"
