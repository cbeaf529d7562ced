"""`planspace measure`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.cli.tables import print_columns, print_json, print_values


@dataclass(frozen=True)
class Measure:
    """Measure the geometry of an embedding on demonstrations.

    The raw state and a constant are measured for comparison. If the embedding was trained on these
    demonstrations, each split is measured separately. An embedding that throws the state away can be
    perfectly straight, so look at effective_rank and decoded_error, too.
    """

    embedding: Positional[Annotated[Path, arg(metavar="EMBEDDING")]]
    """An embedding folder."""
    demos: Positional[Annotated[Path, arg(metavar="DEMOS")]]
    """A dataset folder whose states have the names that the embedding reads."""
    truth: Annotated[Path | None, arg(metavar="FILE.npz", help_behavior_hint="(default: none)")] = None
    """Shortest times to the goal, if they are known, to correlate with distances in z: `states` [n, state],
    `time` [n] in seconds, `goal` [state]."""
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
        from planspace.storage.files import make_folder

        demos, embedding = load_demos(self.demos), load_embedding(self.embedding)
        if self.plot is not None:
            make_folder(self.plot)
        found = measure_embedding(embedding, demos, truth=self.truth).to_dict()
        if self.plot is not None:
            from planspace.figures.embedding_figures import draw_embedding

            draw_embedding(embedding, self.embedding, demos, self.plot)
            found["figures"] = str(self.plot)
        if self.json:
            print_json(found)
            return
        for split, columns in found.pop("splits").items():
            intervals = {k: f"[{low:.3g}, {high:.3g}]" for k, (low, high) in columns["intervals"].items()}
            shown = {"z": columns["embedding"], "95 % interval": intervals}
            print_columns(split, shown | {"raw state": columns["raw_state"], "constant": columns["constant"]})
            print()
        print_values(found)
