"""Problems of a block folder, collected during reading and reported at once, one line for each cause."""

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.block.problems import BlockError, Problem, shown

FIRST_LINES = 3  # maximum number of line numbers in one sentence
LISTED = 10  # maximum number of names in one sentence
SUBJECTS = 1000  # maximum number of subjects of one finding


@dataclass(frozen=True)
class Placed:
    """A problem with its file and line; line 0 is the file as a whole."""

    file: str
    line: int
    problem: Problem
    cause: bool = False  # is reported before all others

    def __str__(self) -> str:
        file = shown(self.file)
        place = f"{file}:{self.line}: " if self.line else f"{file}: " if file else ""
        return f"{place}{self.problem.what}; {self.problem.cure}"


@dataclass
class Noted:
    """Collects problems. `files` are those read so far, in order; `remarks` do not forbid the block.

    `touched` names the images and points in wrong rows: problems that follow only from these are not reported.
    `broken` are the fields of rows that could not be read: names in these fields are not reported as missing.
    `lost_images`: rays name images that do not exist, so other images may have too few rays. `called`: name of a
    file in messages, "" where the settings are not from a file.
    """

    files: list[str] = field(default_factory=list)
    found: list[Placed] = field(default_factory=list)
    remarks: list[Finding] = field(default_factory=list)
    touched: set[str] = field(default_factory=set)
    broken: set[str] = field(default_factory=set)
    lost_images: bool = False
    called: dict[str, str] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.found)

    def add(self, file: str, line: int, what: str, cure: str, touched: Iterable[str] = ()) -> None:
        """Notes one problem of a file."""
        self.found.append(Placed(file, line, Problem(what, cure, file)))
        self.touched.update(touched)

    def add_rows(self, file: str, lines: Sequence[int], what: str, cure: str) -> None:
        """Notes one problem of one or more rows; `what` describes it for the first row."""
        count = len(lines)
        told = what if count == 1 else f"{count} rows ({lines_of(lines)}), such as {what}"
        self.found.append(Placed(file, int(lines[0]), Problem(told, cure, file, count=count)))

    def add_problem(self, file: str, line: int, problem: Problem) -> None:
        """Notes a complete problem without changes."""
        self.found.append(Placed(file, line, problem))

    def add_cause(self, file: str, line: int, what: str, cure: str) -> None:
        """Notes a problem from which others may follow."""
        self.found.append(Placed(file, line, Problem(what, cure, file), cause=True))

    def error(self) -> BlockError:
        """All problems: causes first, then in the order of files and lines; problems without a file last."""
        order = {file: k for k, file in enumerate(self.files)}

        def place(placed: Placed) -> tuple[bool, int, int]:
            return not placed.cause, order.get(placed.file, len(order)), placed.line

        found = [self._called(placed) for placed in sorted(self.found, key=place)]
        return BlockError([placed.problem for placed in found], [str(placed) for placed in found])

    def _called(self, placed: Placed) -> Placed:
        if placed.file not in self.called:
            return placed
        file = self.called[placed.file]
        return dataclasses.replace(placed, file=file, problem=dataclasses.replace(placed.problem, table=file))


def lines_of(lines: Sequence[int]) -> str:
    """Line numbers in one sentence, the first few if there are many."""
    more = ", ..." if len(lines) > FIRST_LINES else ""
    return f"lines {', '.join(str(int(line)) for line in lines[:FIRST_LINES])}{more}"


def listed(names: Sequence[str]) -> str:
    """Names in one sentence, the first few if there are many."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(shown(name) for name in names[:LISTED]) + more


def measured_again(rays: Sequence[tuple[str, str]]) -> Finding:
    """The finding about rays (image and point) whose point is measured by an earlier ray of the same image."""
    subjects = tuple(Subject("rays", (image, point)) for image, point in rays[:SUBJECTS])
    if len(rays) == 1:
        image, point = rays[0]
        what = f"point {listed([point])} is measured twice on image {listed([image])}; both are used as observations"
    else:
        points = listed(list(dict.fromkeys(point for _, point in rays)))
        what = f"{len(rays)} rays repeat a point on the same image; all are used as observations: points {points}"
    cure = "drop the wrong ones if each point was meant to be measured once"
    return Finding(Kind.INFORMATION, what, cure, subjects, grade=Severity.CHECK)
