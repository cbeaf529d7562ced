"""The model card: what an embedding is, how it was trained, and its limits, in Markdown."""

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
    "path_error_std": ("standard deviation of the path error", ""),
    "duration_error": ("duration error", "0"),
    "effective_rank": ("effective rank", ""),
    "active_dims": ("active dimensions of z", "all"),
    "decoded_error": ("decoded error", "0"),
}
"""Fields of `Geometry`: their title, and their ideal value for straight plans that keep the whole state."""
CHOICE = {
    "modern": "the lowest midpoint error on the validation split among the seeds with no collapsed dimension",
    "paper": "the lowest path error on the training split, as in the paper",
}
"""How each preset selects a seed."""
SMALLEST_FIXED = 0.01
"""Numbers below it are shown with two digits instead of three decimals."""


def model_card(embedding: Embedding) -> str:
    """Describe an embedding in Markdown.

    Args:
        embedding: what its `about` does not hold is left out of the card.

    Returns:
        The card. `fit_embedding` saves it as README.md in the embedding's folder, where its example runs.
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
        f"This embedding maps {numbers}. In a plan-space embedding, demonstrated plans are straight lines at "
        "constant speed, so that |z(a) - z(b)| measures the effort between two states. An agent observes z "
        "in addition to the state, or instead of it."
    )
    if objective := about.get("objective", {}):
        text += (
            f" It was trained with the objective {_code(objective['name'])}: {_plain(objective['summary'])}"
        )
    return f"# Plan-space embedding{of}\n\n{text}\n\nSHA-256 of inputs and weights: {_code(embedding.hash)}"


def _use(embedding: Embedding) -> str:
    n, z = embedding.state_dim, embedding.z_dim
    return f"""## How to use it

```python
import numpy as np
import planspace

embedding = planspace.load_embedding(".")  # the folder that holds this file
a, b = np.zeros({n}), np.ones({n})  # two states; the table below lists their numbers
z = embedding.encode(a)  # [{n}] to [{z}]; leading axes are kept: [time, {n}] to [time, {z}]
far = embedding.distance(a, b)
```"""


def _inputs(embedding: Embedding) -> str:
    inputs = embedding.inputs
    circular = ["yes" if c in inputs.circular_columns else "no" for c in range(embedding.state_dim)]
    rows = [
        [str(i), _code(name), unit or "not known", on_circle]
        for i, (name, unit, on_circle) in enumerate(zip(inputs.names, inputs.units, circular, strict=True))
    ]
    how = "Each number is standardised by its mean and standard deviation in the training demonstrations."
    if inputs.form == "raw":
        how = "The numbers are used as they are."
    if inputs.circular_columns:
        how += (
            " Before that, an angle on a circle is replaced by its sine and cosine, so that full turns do "
            "not matter."
            if inputs.form == "trig"
            else " So an angle and the same angle one full turn later are different states."
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
    selected = about.get("seed")
    if selected is None:
        return ""
    if len(seeds) < 2:
        return f"one seed: {selected}"
    choice = CHOICE.get(about.get("preset", ""))
    line = f"seeds {', '.join(map(str, seeds))}; {selected} is selected" + (f": {choice}" if choice else "")
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
    baselines = [("raw state", "metrics_raw_state"), ("constant z", "metrics_constant")]
    baselines = [(title, about[key]) for title, key in baselines if about.get(key)]
    rows = []
    for name in names:
        z = _number(metrics[name])
        if name in intervals:
            z += " [{}, {}]".format(*map(_number, intervals[name]))
        rows.append([METRICS[name][0], z, *(_number(g.get(name)) for _, g in baselines), METRICS[name][1]])
    header = [
        "metric",
        "z [95 % interval]" if intervals else "z",
        *(title for title, _ in baselines),
        "ideal",
    ]
    measured = f"the {_count(metrics['num_demos'], 'demonstration')} of" if "num_demos" in metrics else ""
    text = (
        f"Measured on {measured} the test split, which was used neither to train nor to select the seed. "
        "`planspace measure` measures other demonstrations. `Geometry` in `planspace.embed.geometry` defines "
        "the metrics."
    )
    return f"## Geometry on the test split\n\n{_table(header, rows)}\n\n{' '.join(text.split())}"


def _limits(embedding: Embedding) -> str:
    guess = "z is reliable only near states that the demonstrations cover."
    if embedding.support is not None:
        guess += " `embedding.outside_support(states)` tells which states are outside."
    limits = [
        "An embedding that drops parts of the state can be straight: one that only encodes the time left "
        "would score well. Read straightness together with the effective rank and the decoded error.",
        guess,
        "|z(a) - z(b)| is symmetric, but effort is not: a pole falls without effort, and must be swung up.",
        "The embedding reflects its demonstrations and their goals. It knows no obstacles besides theirs.",
    ]
    return "## Limits\n\n" + "\n".join(f"- {limit}" for limit in limits)


def _versions(about: Mapping[str, Any]) -> str:
    versions = about.get("versions", {})
    return "## Versions\n\n" + ", ".join(f"{k} {v}" for k, v in versions.items()) if versions else ""


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def _code(text: str) -> str:
    """Format text as code, so that names from a file cannot become headings, links or HTML."""
    return f"`{' '.join(text.replace('`', chr(39)).split())}`"


def _plain(text: str) -> str:
    """Remove characters with a meaning in Markdown or HTML."""
    return re.sub(r"[<>\[\]`#|\\]", " ", text)


def _count(num: int, noun: str) -> str:
    return f"{num} {noun}" + ("" if num == 1 else "s")


def _number(value: int | float | None) -> str:
    if value is None or value != value:  # NaN
        return "-"
    if isinstance(value, int):
        return str(value)
    return f"{value:.3f}" if value == 0 or abs(value) >= SMALLEST_FIXED else f"{value:.2g}"
