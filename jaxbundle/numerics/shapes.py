"""Padded sizes of arrays: arrays with equal shapes share one compiled program."""


def grid_size(count: int, least: int = 16, ratio: float = 1.125) -> int:
    """The next size on a geometric grid: few sizes mean few compilations."""
    size = least
    while size < count:
        size = int(size * ratio) + 1
    return size
