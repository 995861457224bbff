"""Problems of a block in the user's names, each with its cure, told all at once."""

from dataclasses import dataclass

SHOWN = 200  # a terminal's worth; the rest is counted


@dataclass(frozen=True)
class Problem:
    """What is wrong, what cures it, and where: a table of the block and a row in it (counted from 0)."""

    what: str
    cure: str
    table: str = ""
    row: int | None = None

    def __str__(self) -> str:
        place = f"{self.table}, row {self.row}: " if self.row is not None else f"{self.table}: " if self.table else ""
        return f"{place}{self.what}; {self.cure}"


class BlockError(ValueError):
    """Bad input: all problems of a block at once. `places` may replace table and row by file and line."""

    def __init__(self, problems: list[Problem], lines: list[str] | None = None):
        self.problems = tuple(problems)
        self.lines = tuple(lines if lines is not None else [str(problem) for problem in problems])
        count = len(self.lines)
        head = "1 problem in the block" if count == 1 else f"{count} problems in the block"
        more = [f"  ... and {count - SHOWN} more"] if count > SHOWN else []
        super().__init__("\n".join([f"{head}:", *(f"  {line}" for line in self.lines[:SHOWN]), *more]))
