"""Problems of a block in the user's names, each with its cure, reported all at once."""

import unicodedata
from dataclasses import dataclass

SHOWN = 200  # number of lines for a terminal; the rest is counted
LONGEST = 60  # maximum number of characters of one value in a message
HIDDEN = ("Cc", "Cs", "Zl", "Zp")  # categories of Unicode: control, not a character, breaks of lines and paragraphs
TURNING = {
    0x061C,
    0x200E,
    0x200F,
    *range(0x202A, 0x202F),
    *range(0x2066, 0x206A),
}  # characters for the direction of writing
WITHOUT_WIDTH = {0x200B, 0x2060, 0xFEFF}
UNSEEN = frozenset(map(chr, TURNING | WITHOUT_WIDTH))


@dataclass(frozen=True)
class Problem:
    """A problem, its cure, and its position: a table of the block and a row in it (counted from 0).

    `count`: number of affected rows; the first one is `row`.

    Example:
        >>> problem = jb.blocks.Problem("sZ of point A is 0", "give a positive number", "control", 0)
        >>> problem.what, problem.row
        ('sZ of point A is 0', 0)
    """

    what: str
    cure: str
    table: str = ""
    row: int | None = None
    count: int = 1

    def __str__(self) -> str:
        place = f"{self.table}, row {self.row}: " if self.row is not None else f"{self.table}: " if self.table else ""
        return f"{place}{self.what}; {self.cure}"


class BlockError(ValueError):
    """The error for bad input, with all problems of a block. `lines`: with file and line, or table and row.

    Example:
        >>> try:
        ...     jb.read("no_folder")
        ... except jb.BlockError as error:
        ...     print(len(error.problems))
        1
    """

    def __init__(self, problems: list[Problem], lines: list[str] | None = None):
        self.problems = tuple(problems)
        told = lines if lines is not None else [str(problem) for problem in problems]
        self.lines = tuple(printable(line) for line in told)
        count = len(self.lines)
        head = "1 problem in the block" if count == 1 else f"{count} problems in the block"
        more = [f"  ... and {count - SHOWN} more"] if count > SHOWN else []
        super().__init__("\n".join([f"{head}:", *(f"  {line}" for line in self.lines[:SHOWN]), *more]))


def is_hidden(character: str) -> bool:
    """Whether a character is invisible: it breaks a line, controls a terminal or changes the direction of writing."""
    return unicodedata.category(character) in HIDDEN or character in UNSEEN


def printable(text: str) -> str:
    """The text with invisible characters as escapes, such as \\x1b."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(c.encode("unicode_escape").decode() if is_hidden(c) else c for c in text)


def shown(text: str, longest: int = LONGEST) -> str:
    """A value for a message: without invisible characters; a long one is shortened, with its length."""
    begin = printable(text[:longest])
    return begin if len(text) <= longest else f"{begin}... ({len(text)} characters)"
