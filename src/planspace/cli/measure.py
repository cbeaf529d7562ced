"""`planspace measure`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.cli.tables import print_columns, print_values


@dataclass(frozen=True)
class Measure:
    """Measure an embedding's geometry on demonstrations, beside the raw state's and a constant's.

    On the demonstrations it was trained on, each split is measured by itself. Straightness can be won by
    throwing state away: look at effective_rank and decoded_error, too.
    """

    embedding: Positional[Annotated[Path, arg(metavar="EMBEDDING")]]
    """An embedding's folder."""
    demos: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder; any whose states have the names the embedding reads."""
    truth: Annotated[Path | None, arg(metavar="FILE.npz", help_behavior_hint="(default: none)")] = None
    """The least times to the goal, if they are known, to correlate distances with: `states` [n, state],
    `time` [n] in seconds, `goal` [state]."""
    plot: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """Draw paths in z, distance against time, and the curves of the training into DIR. Of the demonstrations
    it was trained on, the test split is drawn."""
    json: bool = False
    """Print JSON."""

    def __call__(self) -> None:
        """Prints the metrics."""
        from planspace.demos.folder import load_demos
        from planspace.embed.embedding import load_embedding
        from planspace.embed.measurement import assess
        from planspace.storage.files import make_folder

        demos, embedding = load_demos(self.demos), load_embedding(self.embedding)
        if self.plot is not None:
            make_folder(self.plot)
        found = assess(embedding, demos, self.truth)
        if self.plot is not None:
            from planspace.figures.embedding_figures import draw_embedding

            draw_embedding(embedding, self.embedding, demos, self.plot)
            found["figures"] = str(self.plot)
        if self.json:
            print(json.dumps(found, indent=2))
            return
        for split, columns in found.pop("splits").items():
            intervals = {k: f"[{low:.3g}, {high:.3g}]" for k, (low, high) in columns["intervals"].items()}
            shown = {"z": columns["embedding"], "95 % interval": intervals}
            print_columns(split, shown | {"raw state": columns["raw_state"], "constant": columns["constant"]})
            print()
        print_values(found)
