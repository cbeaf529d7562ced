"""The shipped tasks, one module each; `tasks.catalog` finds them here."""
