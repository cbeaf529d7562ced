"""How many physics steps this process has simulated, in all simulations together."""

_taken = 0


def count_steps(number: int) -> None:
    """Add physics steps that were taken."""
    global _taken
    _taken += number


def steps_taken() -> int:
    """The physics steps that this process has taken so far."""
    return _taken
