"""The command line: one file a verb, listed in `planspace.cli.entry.VERBS`."""

from planspace.cli.entry import main

__all__ = ["main"]
