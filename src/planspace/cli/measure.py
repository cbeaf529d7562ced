"""`planspace measure`."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from planspace.cli.config_files import check_least
from planspace.cli.tables import print_columns, print_json, print_values


@dataclass(frozen=True)
class Measure:
    """Measure the geometry of an embedding on demonstrations.

    The raw state and a constant are measured for comparison. If the embedding was trained on these
    demonstrations, each split is measured separately. An embedding that throws the state away can be
    perfectly straight, so look at effective_rank and decoded_error, too. `n/a` means that there is nothing
    to measure. The last lines say in words what is good, what is weak, what the demonstrations do not
    support, and what to try.
    """

    embedding: Positional[Annotated[Path, arg(metavar="EMBEDDING")]]
    """An embedding folder, or the name of a ready-made one."""
    demos: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder, or the name of ready-made plans. Its states must have the names that the embedding
    reads."""
    truth: Annotated[Path | None, arg(metavar="FILE.npz", help_behavior_hint="(default: none)")] = None
    """Shortest times between states, if they are known, to compare with distances: `states` [n, state],
    `time` [n] in seconds, and `goals` [n, state] or one `goal` [state]. An optional `on_plans` [n] (bool)
    says which states lie on a plan to their goal; those are also measured separately."""
    folds: Annotated[int, arg(metavar="N", help_behavior_hint="(default: none)")] = 0
    """For few demonstrations: divide them into N parts, train again without each part, and measure that
    part, so that all are measured by an embedding that has not seen them (split `folds`). Takes N trainings
    of one seed."""
    plot: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """Draw paths in z, distance against time, and the training curves into DIR. If the embedding was trained
    on these demonstrations, only the test split is drawn."""
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Print the metrics."""
        from planspace.demos.load import load_demos
        from planspace.embed.measurement import measure_embedding
        from planspace.embed.saved_embedding import load_embedding
        from planspace.storage.compiled import use_compilation_cache
        from planspace.storage.files import make_folder

        check_least(self, folds=0)
        if self.folds:
            use_compilation_cache()
        demos, embedding = load_demos(self.demos), load_embedding(self.embedding)
        if self.plot is not None:
            make_folder(self.plot)
        found = measure_embedding(embedding, demos, truth=self.truth, folds=self.folds).to_dict()
        if self.plot is not None:
            from planspace.figures.embedding_figures import draw_embedding

            draw_embedding(embedding, self.embedding, demos, self.plot)
            found["figures"] = str(self.plot)
        if self.json:
            print_json(found)
            return
        quality, verdict = found.pop("demonstrations"), found.pop("verdict")
        for split, columns in found.pop("splits").items():
            _print_split(split, columns)
        for subset, distances in found.pop("true_times", {}).items():
            _print_true_times(subset, distances)
            print()
        print_values(found)
        _print_sampling(quality)
        _print_verdict(verdict)


def _print_split(split: str, columns: Mapping[str, Any]) -> None:
    """Print the metrics of a split, and why some are missing."""
    intervals = {k: f"[{low:.3g}, {high:.3g}]" for k, (low, high) in columns["intervals"].items()}
    shown = {"z": columns["embedding"], "95 % interval": intervals}
    print_columns(split, shown | {"raw state": columns["raw_state"], "constant": columns["constant"]})
    names_by_reason: dict[str, list[str]] = {}
    for name, reason in columns["not_available"].items():
        names_by_reason.setdefault(reason, []).append(name)
    for reason, names in names_by_reason.items():
        print(f"  n/a: {', '.join(names)} ({reason})")
    print()


def _print_sampling(quality: Mapping[str, Any]) -> None:
    """Print how the sampling rate enters the metrics."""
    spacings = ", ".join(f"{spacing:.3g}" for spacing in quality["spacings_s"])
    print(
        f"\nsampling: one state every {quality['step_s']:.3g} s; midpoint_error compares states {spacings} s "
        "apart.\n  The rate changes speed_variation, midpoint_error and, with noise, straightness and "
        "path_error:\n  compare only demonstrations of the same rate."
    )


def _print_verdict(verdict: Mapping[str, Sequence[str]]) -> None:
    """Print the measurement in words."""
    print("\nverdict")
    for name, sentences in verdict.items():
        for sentence in sentences:
            print(textwrap.fill(f"  {name.replace('_', ' '):<15}{sentence}", 110, subsequent_indent=" " * 17))


def _print_true_times(subset: str, distances: Mapping[str, Mapping[str, Any]]) -> None:
    """Print how well each distance predicts the shortest times of some pairs."""
    named = {name.replace("_", " "): values for name, values in distances.items()}
    print_columns(f"true times, {subset.replace('_', ' ')}", {k: _numbers(v) for k, v in named.items()})
    tenths = {}
    for name, values in named.items():
        tenths[name] = _numbered(values["predicted"])
        tenths[f"true ({name})"] = _numbered(values["true"])
    print_columns("mean [s], by tenths", tenths)


def _numbered(values: Sequence[float]) -> dict[str, float]:
    return {str(i): value for i, value in enumerate(values, start=1)}


def _numbers(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if not isinstance(value, tuple)}
