"""What can go wrong with a particle in a time step, as bits (algorithm 12.2 C)."""

NON_FINITE, OUTSIDE, INVERTED, TOO_FAST = 1, 2, 4, 8

FAULTS = {
    NON_FINITE: "non-finite value",
    OUTSIDE: "particle out of the domain",
    INVERTED: "det F <= 0",
    TOO_FAST: "particle faster than the grid allows",
}


def fault_names(faults: int) -> tuple[str, ...]:
    """The faults whose bits are set, in words."""
    return tuple(name for bit, name in FAULTS.items() if faults & bit)
