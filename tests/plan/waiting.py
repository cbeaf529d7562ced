"""A planner that waits at one start for as long as the environment variable WAIT_AT names it."""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .bang_bang import BangBang


@dataclass(frozen=True)
class Waiting(BangBang):
    def plan(self, query: Any, rng: Any) -> Any:
        start = float(query.start[0])
        folder = Path(os.environ["WAITING_FOLDER"])
        (folder / f"at {start!r}").touch()
        while os.environ.get("WAIT_AT") == repr(start):
            time.sleep(0.05)
        found = super().plan(query, rng)
        (folder / f"found {start!r}").touch()
        return found
