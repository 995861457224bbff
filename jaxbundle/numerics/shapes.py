"""Padded sizes of arrays: what has equal shapes shares one compiled program."""


def grid_size(count: int, least: int = 16, ratio: float = 1.125) -> int:
    """The next size on a geometric grid: few sizes, few compilations."""
    size = least
    while size < count:
        size = int(size * ratio) + 1
    return size
