"""What an import found or changed: each kind once, with its count and the first places."""

from dataclasses import dataclass, field

MAX_PLACES = 3
"""Number of places that a line names."""


@dataclass
class Finding:
    """Something that was found at one or more places."""

    count: int = 0
    places: list[str] = field(default_factory=list)

    def add(self, place: str, count: int = 1) -> None:
        """Count it, and remember the place if it is one of the first.

        Args:
            place: where it begins.
            count: how often it is there.
        """
        self.count += count
        if len(self.places) < MAX_PLACES:
            self.places.append(place)

    def text(self, singular: str, plural: str = "") -> str:
        """A line such as `3 rows out of order: sorted (log.csv, line 7; ...)`.

        Args:
            singular: what it is and what was done, for one.
            plural: the same for several; empty if it is the same text.
        """
        what = singular if self.count == 1 else plural or singular
        more = "; ..." if self.count > len(self.places) else ""
        return f"{self.count} {what} ({'; '.join(self.places)}{more})"
