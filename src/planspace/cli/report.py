"""`planspace report`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


@dataclass(frozen=True)
class Report:
    """Write the report of a `planspace run` anew; what the run had not finished is finished first."""

    folder: Positional[Annotated[Path, arg(metavar="DIR")]]
    """The run's folder."""
    json: bool = False
    """Print the summary as JSON."""

    def __call__(self) -> None:
        """Writes it and prints the closing table."""
        from planspace.study.quickstart import closing_table, rebuild

        summary = rebuild(self.folder)
        print(json.dumps(summary, indent=2) if self.json else closing_table(summary))
