"""Capacities of growing arrays: few sizes, because each is a compilation."""


def capacity_for(size: int, least: int) -> int:
    """Return the least of `least` · (3/2)ⁱ, rounded down, that holds `size`."""
    capacity = least
    while capacity < size:
        capacity = capacity * 3 // 2
    return capacity
