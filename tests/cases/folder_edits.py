"""Changes of a block folder, one mistake each."""

from collections.abc import Callable
from pathlib import Path

from cases.small_folder import BLOCK_TOML, append, change, write

Edit = Callable[[Path], object]


def line(file: str, number: int, old: str, new: str) -> Edit:
    """Changes one line."""
    return lambda folder: change(folder, file, number, old, new)


def added(file: str, text: str) -> Edit:
    """Adds a line."""
    return lambda folder: append(folder, file, text)


def removed(file: str) -> Edit:
    """Takes a file away."""
    return lambda folder: (folder / file).unlink()


def table(kind: str, header: str, *rows: str) -> Edit:
    """Adds a table and its entry in block.toml."""

    def edit(folder: Path) -> None:
        append(folder, "block.toml", f'{kind} = "{kind}.csv"')
        write(folder, f"{kind}.csv", header, list(rows))

    return edit


def toml(number: int, old: str, new: str) -> Edit:
    """Changes one line of block.toml."""
    return line("block.toml", number, old, new)


def dropped(file: str, *starts: str) -> Edit:
    """Drops the rows that begin so."""

    def edit(folder: Path) -> None:
        rows = (folder / file).read_text().splitlines()
        write(folder, file, rows[0], [row for row in rows[1:] if not row.startswith(starts)])

    return edit


def without_cameras(folder: Path) -> None:
    """Cuts the section of the camera out."""
    before, _, after = BLOCK_TOML.partition("[cameras.wide]")
    (folder / "block.toml").write_text(before + after[after.index("[sigma]") :])


STATIONS = "image,X,Y,Z,sX,sY,sZ"
