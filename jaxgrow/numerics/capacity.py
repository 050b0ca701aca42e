"""Sizes of arrays that grow: few of them, because each is a compilation."""


def capacity_for(size: int, least: int) -> int:
    """The smallest of `least`, `least` · 3/2, `least` · 9/4, … that holds `size`."""
    capacity = least
    while capacity < size:
        capacity = capacity * 3 // 2
    return capacity
