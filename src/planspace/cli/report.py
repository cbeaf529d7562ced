"""`planspace report`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from planspace.cli.tables import print_json


@dataclass(frozen=True)
class Report:
    """Write the report of a `planspace run` again.

    Unfinished stages of the run are finished first.
    """

    folder: Positional[Annotated[Path, arg(metavar="DIR")]]
    """The run's folder."""
    json: bool = False
    """Print the summary as JSON."""

    def __call__(self) -> None:
        """Write the report and print the summary."""
        from planspace.study.quickstart import rebuild
        from planspace.study.run_summary import as_json
        from planspace.study.run_text import as_text, headline

        summary = rebuild(self.folder)
        if self.json:
            print_json(as_json(summary))
        else:
            print(as_text(summary))
            print(f"\n{headline(summary.control)}" if summary.control.reached else "")
