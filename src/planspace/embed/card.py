"""The model card: what an embedding is, where it comes from and what it cannot do, in Markdown."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from planspace.embed.embedding import Embedding

METRICS = {
    "straightness": ("straightness", "1"),
    "speed_variation": ("speed variation", "0"),
    "midpoint_error": ("midpoint error", "0"),
    "time_correlation": ("correlation with time left", "1"),
    "path_error": ("path error (the paper's)", ""),
    "path_error_std": ("deviation of the path error", ""),
    "duration_error": ("duration error", "0"),
    "effective_rank": ("effective rank", ""),
    "active_dims": ("active dimensions of z", "all"),
    "decoded_error": ("decoded error", "0"),
}
"""Fields of `Geometry`: what they are called, and what they are for straight plans with no state lost."""
CHOICE = {
    "modern": "the lowest midpoint error on the validation split among the seeds with no collapsed dimension",
    "paper": "the lowest path error on the training split, as in the paper",
}
"""How `fit` chooses among seeds."""
SMALLEST_FIXED = 0.01
"""Numbers below it are shown with two digits instead of three decimals."""


def model_card(embedding: Embedding) -> str:
    """Describes an embedding in Markdown, from what it holds alone.

    Args:
        embedding: of its `about`, whatever is absent is left out of the card.

    Returns:
        The card; `fit` saves it as README.md beside the embedding, where its example runs.
    """
    sections = [
        _head(embedding),
        _use(embedding),
        _inputs(embedding),
        _training(embedding.about),
        _geometry(embedding),
        _limits(embedding),
        _versions(embedding.about),
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def _head(embedding: Embedding) -> str:
    about = embedding.about
    of = f" of {_code(about['problem'])}" if about.get("problem") else ""
    numbers = (
        f"a state of {_count(embedding.state_dim, 'number')} to z of {_count(embedding.z_dim, 'number')}"
    )
    text = (
        f"Maps {numbers}. In a plan-space embedding, demonstrated plans are straight lines, run through at "
        "constant speed: |z(a) - z(b)| then says how far apart two states are for such plans. z is what an "
        "agent observes beside the state, or instead of it."
    )
    if objective := about.get("objective", {}):
        text += f" The objective of this one is {_code(objective['name'])}: {_plain(objective['summary'])}"
    return f"# Plan-space embedding{of}\n\n{text}\n\nSHA-256 of what it computes: {_code(embedding.hash)}"


def _use(embedding: Embedding) -> str:
    n, z = embedding.state_dim, embedding.z_dim
    return f"""## How to use it

```python
import numpy as np
import planspace

embedding = planspace.load_embedding(".")  # the folder that holds this file
a, b = np.zeros({n}), np.ones({n})  # two states; the inputs below say what the numbers are
z = embedding.encode(a)  # [{n}] to [{z}]; any axes may come before: [time, {n}] to [time, {z}]
far = embedding.distance(a, b)
```"""


def _inputs(embedding: Embedding) -> str:
    inputs = embedding.inputs
    circular = ["yes" if c in inputs.circular_columns else "no" for c in range(embedding.state_dim)]
    rows = [
        [str(i), _code(name), unit or "not known", on_circle]
        for i, (name, unit, on_circle) in enumerate(zip(inputs.names, inputs.units, circular, strict=True))
    ]
    how = "Each number is standardised by the training demonstrations."
    if inputs.form == "raw":
        how = "The numbers enter as they are."
    if inputs.circular_columns:
        how += (
            " Before that, an angle on a circle becomes its sine and cosine: whole turns do not matter."
            if inputs.form == "trig"
            else " An angle on a circle and the same angle a turn later are therefore two states to it."
        )
    return f"## Inputs\n\n{_table(['', 'state', 'unit', 'on a circle'], rows)}\n\n{how}"


def _training(about: Mapping[str, Any]) -> str:
    settings = about.get("settings", {})
    config = settings.get("fit", {})
    lines = [
        _preset(about, config.get("objective", {})),
        _seeds(about, settings.get("seeds", [])),
        _length(about),
        _demos(about, settings),
        _split(about.get("split", {}), settings.get("split_seed")),
    ]
    lines = [f"- {line}" for line in lines if line]
    return "## Training\n\n" + "\n".join(lines) if lines else ""


def _preset(about: Mapping[str, Any], objective: Mapping[str, Any]) -> str:
    parts = [f"preset {_code(about['preset'])}"] if "preset" in about else []
    if "name" in objective:
        numbers = {k: v for k, v in objective.items() if isinstance(v, int | float) and v is not True}
        weights = ", ".join(f"{k} {v:g}" for k, v in numbers.items() if v)
        parts.append(f"objective {_code(objective['name'])}" + (f" ({weights})" if weights else ""))
    return ", ".join(parts)


def _seeds(about: Mapping[str, Any], seeds: Sequence[int]) -> str:
    kept = about.get("seed")
    if kept is None:
        return ""
    if len(seeds) < 2:
        return f"one seed: {kept}"
    choice = CHOICE.get(about.get("preset", ""))
    line = f"seeds {', '.join(map(str, seeds))}; {kept} is kept" + (f": {choice}" if choice else "")
    errors = [g.get("midpoint_error") for g in about.get("metrics_of_seeds", {}).values()]
    if errors and None not in errors:
        line += (
            f" (midpoint errors on the validation split: {_number(min(errors))} to {_number(max(errors))})"
        )
    return line


def _length(about: Mapping[str, Any]) -> str:
    if about.get("objective", {}).get("closed_form"):
        return "in closed form"
    config = about.get("settings", {}).get("fit", {})
    if "steps" not in config or "batch" not in config:
        return ""
    return f"{config['steps']:,} optimiser steps of {config['batch']:,} triplets of states"


def _demos(about: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    if "demos" not in settings:
        return ""
    split = about.get("split")
    line = _count(sum(map(len, split.values())), "demonstration") if split else "demonstrations"
    if about.get("problem"):
        line += f" of the problem {_code(about['problem'])}"
    return f"{line}, SHA-256 of their content {_code(settings['demos'])}"


def _split(split: Mapping[str, Sequence[int]], seed: int | None) -> str:
    if not split:
        return ""
    sizes = ", ".join(f"{len(part)} {name}" for name, part in split.items())
    return f"split by whole demonstrations: {sizes}" + ("" if seed is None else f" (split seed {seed})")


def _geometry(embedding: Embedding) -> str:
    about = embedding.about
    metrics = about.get("metrics", {}).get("test", {})
    names = [name for name in METRICS if name in metrics]
    if not names:
        return ""
    intervals = about.get("intervals", {}).get("test", {})
    beside = [("raw state", "metrics_raw_state"), ("constant z", "metrics_constant")]
    beside = [(title, about[key]) for title, key in beside if about.get(key)]
    rows = []
    for name in names:
        z = _number(metrics[name])
        if name in intervals:
            z += " [{}, {}]".format(*map(_number, intervals[name]))
        rows.append([METRICS[name][0], z, *(_number(g.get(name)) for _, g in beside), METRICS[name][1]])
    header = ["metric", "z [95 % interval]" if intervals else "z", *(title for title, _ in beside), "ideal"]
    measured = f"the {_count(metrics['num_demos'], 'demonstration')} of" if "num_demos" in metrics else ""
    text = (
        f"Measured on {measured} the test split, which took no part in training or in the choice of the "
        "seed. `planspace measure` measures it on others; `Geometry` in `planspace.embed.geometry` says what "
        "each metric is."
    )
    return f"## Geometry on the test split\n\n{_table(header, rows)}\n\n{' '.join(text.split())}"


def _limits(embedding: Embedding) -> str:
    guess = "Outside what the demonstrations cover, z is a guess."
    if embedding.support is not None:
        guess += " `embedding.outside_support(states)` says which states those are."
    limits = [
        "Straightness can be won by throwing state away: the time left alone would score well. Read the "
        "effective rank and the decoded error beside it.",
        guess,
        "|z(a) - z(b)| is the same both ways; effort is not: a pole falls by itself, and must be swung up.",
        "It knows the plans it was shown, with their goals, and nothing of obstacles they did not meet.",
    ]
    return "## Limits\n\n" + "\n".join(f"- {limit}" for limit in limits)


def _versions(about: Mapping[str, Any]) -> str:
    versions = about.get("versions", {})
    return "## Versions\n\n" + ", ".join(f"{k} {v}" for k, v in versions.items()) if versions else ""


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def _code(text: str) -> str:
    """Text as code, whatever is in it: a file's names must not turn into headings, links or HTML."""
    return f"`{' '.join(text.replace('`', chr(39)).split())}`"


def _plain(text: str) -> str:
    """Text without characters that Markdown or HTML give a meaning."""
    return re.sub(r"[<>\[\]`#|\\]", " ", text)


def _count(num: int, noun: str) -> str:
    return f"{num} {noun}" + ("" if num == 1 else "s")


def _number(value: int | float | None) -> str:
    if value is None or value != value:  # NaN
        return "-"
    if isinstance(value, int):
        return str(value)
    return f"{value:.3f}" if value == 0 or abs(value) >= SMALLEST_FIXED else f"{value:.2g}"
