"""What is wrong in a block folder, collected while reading goes on and told at once."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from jaxbundle.block.problems import BlockError, Problem


@dataclass(frozen=True)
class Finding:
    """A problem and its place; line 0 is the file as a whole."""

    file: str
    line: int
    problem: Problem

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}: " if self.line else f"{self.file}: " if self.file else ""
        return f"{place}{self.problem.what}; {self.problem.cure}"


@dataclass
class Findings:
    """`files` are those read so far, in this order.

    `touched` names the images and points in rows that are wrong: what follows from them alone is not told.
    """

    files: list[str] = field(default_factory=list)
    found: list[Finding] = field(default_factory=list)
    touched: set[str] = field(default_factory=set)

    def __bool__(self) -> bool:
        return bool(self.found)

    def add(self, file: str, line: int, what: str, cure: str, touched: Iterable[str] = ()) -> None:
        """Notes one problem."""
        self.found.append(Finding(file, line, Problem(what, cure, file)))
        self.touched.update(touched)

    def error(self) -> BlockError:
        """All findings, file by file in the order of reading and line by line; those of no file last."""
        order = {file: k for k, file in enumerate(self.files)}
        found = sorted(self.found, key=lambda finding: (order.get(finding.file, len(order)), finding.line))
        return BlockError([finding.problem for finding in found], [str(finding) for finding in found])
