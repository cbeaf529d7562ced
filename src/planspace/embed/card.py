"""The model card: what an embedding is, how it was trained, and its limits, in Markdown."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from planspace.embed.about import About
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
        embedding: without its `about`, the sections on training, geometry and versions are left out.

    Returns:
        The card. `fit_embedding` saves it as README.md in the embedding's folder, where its example runs.
    """
    about = embedding.about
    sections = [_head(embedding), _use(embedding), _inputs(embedding)]
    sections += [] if about is None else [_training(about), _geometry(about)]
    sections += [_limits(embedding)]
    sections += [] if about is None else [_versions(about)]
    return "\n\n".join(sections) + "\n"


def _head(embedding: Embedding) -> str:
    about = embedding.about
    of = f" of {_code(about.problem)}" if about is not None and about.problem else ""
    numbers = (
        f"a state of {_count(embedding.state_dim, 'number')} to z of {_count(embedding.z_dim, 'number')}"
    )
    text = (
        f"This embedding maps {numbers}. In a plan-space embedding, demonstrated plans are straight lines at "
        "constant speed, so that |z(a) - z(b)| measures the effort between two states. An agent observes z "
        "in addition to the state, or instead of it."
    )
    if about is not None and about.objective is not None:
        objective = about.objective
        text += f" It was trained with the objective {_code(objective.name)}: {_plain(objective.summary)}"
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
    for w, x, y, z in inputs.quaternions:
        how += f" {', '.join(_code(inputs.names[c]) for c in (w, x, y, z))} are a quaternion (w, x, y, z)" + (
            ", which is replaced by the first two columns of its rotation matrix, so that its sign does not "
            "matter."
            if inputs.form == "trig"
            else "; with another sign it is another state."
        )
    return f"## Inputs\n\n{_table(['', 'state', 'unit', 'on a circle'], rows)}\n\n{how}"


def _training(about: About) -> str:
    lines = [_preset(about), _seeds(about), _length(about), _demos(about), _split(about)]
    return "## Training\n\n" + "\n".join(f"- {line}" for line in lines if line)


def _preset(about: About) -> str:
    parts = [f"preset {_code(about.preset)}"]
    objective: Mapping[str, Any] = about.settings.fit.get("objective", {})
    if "name" in objective:
        numbers = {k: v for k, v in objective.items() if isinstance(v, int | float) and v is not True}
        weights = ", ".join(f"{k} {v:g}" for k, v in numbers.items() if v)
        parts.append(f"objective {_code(objective['name'])}" + (f" ({weights})" if weights else ""))
    return ", ".join(parts)


def _seeds(about: About) -> str:
    seeds = about.settings.seeds
    if len(seeds) < 2:
        return f"one seed: {about.seed}"
    alone = about.metrics["train"].get("path_error", 0.0) is None
    choice = CHOICE.get("modern" if alone else about.preset)
    line = f"seeds {', '.join(map(str, seeds))}; {about.seed} is selected" + (f": {choice}" if choice else "")
    known = [metrics["midpoint_error"] for metrics in about.metrics_of_seeds.values()]
    errors = [error for error in known if error is not None]
    if not errors:
        return line
    return (
        f"{line} (midpoint errors on the validation split: {_number(min(errors))} to {_number(max(errors))})"
    )


def _length(about: About) -> str:
    if about.objective is not None and about.objective.closed_form:
        return "in closed form"
    config = about.settings.fit
    if "steps" not in config or "batch" not in config:
        return ""
    return f"{config['steps']:,} optimiser steps of {config['batch']:,} triplets of states"


def _demos(about: About) -> str:
    line = _count(sum(map(len, about.split.values())), "demonstration")
    if about.problem:
        line += f" of the problem {_code(about.problem)}"
    return f"{line}, SHA-256 of their content {_code(about.settings.demos)}"


def _split(about: About) -> str:
    sizes = ", ".join(f"{len(part)} {name}" for name, part in about.split.items())
    return f"split by whole demonstrations: {sizes} (split seed {about.settings.split_seed})"


def _geometry(about: About) -> str:
    metrics, intervals = about.metrics["test"], about.intervals["test"]
    rows = []
    for name, (title, ideal) in METRICS.items():
        z = _number(metrics[name])
        if name in intervals:
            z += " [{}, {}]".format(*map(_number, intervals[name]))
        baselines = (_number(g.get(name)) for g in (about.metrics_raw_state, about.metrics_constant))
        rows.append([title, z, *baselines, ideal])
    header = ["metric", "z [95 % interval]", "raw state", "constant z", "ideal"]
    count = _count(int(metrics["num_demos"] or 0), "demonstration")
    text = (
        f"Measured on the {count} of the test split, which was used neither to train nor to select the seed. "
        "A metric that cannot be measured has a dash. `planspace measure` measures other demonstrations. "
        "`Geometry` in `planspace.embed.geometry` defines the metrics."
    )
    return f"## Geometry on the test split\n\n{_table(header, rows)}\n\n{text}"


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


def _versions(about: About) -> str:
    return "## Versions\n\n" + ", ".join(f"{k} {v}" for k, v in about.versions.items())


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
