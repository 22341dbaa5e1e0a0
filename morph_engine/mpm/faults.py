"""What can go wrong with a particle in a time step, as bits (algorithm 12.2 C)."""

NON_FINITE, OUTSIDE, INVERTED, TOO_FAST = 1, 2, 4, 8

FAULTS = {
    NON_FINITE: "a value is not finite",
    OUTSIDE: "a particle has left the domain",
    INVERTED: "a particle is turned inside out (det F <= 0)",
    TOO_FAST: "a particle moves faster than the grid allows",
}


def fault_names(faults: int) -> tuple[str, ...]:
    """The faults whose bits are set, in words."""
    return tuple(name for bit, name in FAULTS.items() if faults & bit)
