"""Adjusting many blocks: a failing block does not stop the others, and a table has the outcome of each."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Unpack

from jaxbundle.block.block import Block
from jaxbundle.block.given import require_a
from jaxbundle.block.notebook import table_html
from jaxbundle.block.wording import counted
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.options import Choices, Options, chosen

FAILED = "bad input"
SHOWN = 100  # maximum number of characters of a problem in a line of the table


class Row(NamedTuple):
    """One block of a batch in the table; None for unknown values of a failed block."""

    name: str
    status: str
    observations: int | None = None
    unknowns: int | None = None
    redundancy: int | None = None
    sigma0: float | None = None
    iterations: int | None = None
    seconds: float = 0.0
    problem: str = ""


def row_of(name: str, a: Adjustment, seconds: float) -> Row:
    """The row of an adjustment."""
    status = a.status.name.lower().replace("_", " ")
    problem = "; ".join(finding.words for finding in a.failures)
    sigma0, iterations = float(a.sigma0), int(a.iterations.trials)
    return Row(name, status, a.n_observations, a.n_unknowns, a.redundancy, sigma0, iterations, seconds, problem)


def failed_row(name: str, error: Exception, seconds: float) -> Row:
    """The row of a block without adjustment."""
    return Row(name, FAILED, seconds=seconds, problem=str(error))


@dataclass(frozen=True)
class Outcome:
    """A block of a batch: its adjustment, or the error that prevented it.

    Example:
        >>> outcome = jb.adjust_many({"quarry": block}).outcomes[0]
        >>> outcome.name, outcome.result.success
        ('quarry', True)
    """

    name: str
    result: Adjustment | ValueError
    seconds: float

    @property
    def row(self) -> Row:
        """The row of this outcome for the table."""
        if isinstance(self.result, Adjustment):
            return row_of(self.name, self.result, self.seconds)
        return failed_row(self.name, self.result, self.seconds)


@dataclass(frozen=True)
class Batch:
    """Outcomes in the order of the blocks.

    Example:
        >>> batch = jb.adjust_many({"quarry": block})
        >>> batch.outcomes[0].name
        'quarry'
    """

    outcomes: tuple[Outcome, ...]

    @property
    def adjustments(self) -> list[Adjustment]:
        """Adjustments of the blocks that could be adjusted."""
        return [outcome.result for outcome in self.outcomes if isinstance(outcome.result, Adjustment)]

    @property
    def trustworthy(self) -> bool:
        """Whether all blocks are adjusted and all results can be used."""
        return all(isinstance(o.result, Adjustment) and o.result.trustworthy for o in self.outcomes)

    def table(self) -> list[Row]:
        """The table with one row for each block."""
        return [outcome.row for outcome in self.outcomes]

    def _repr_html_(self) -> str:
        rows = [_cells(row) for row in self.table()]
        return table_html(f"Batch of {counted(len(rows), 'block')}", Row._fields, rows)

    def summary(self) -> str:
        """The table in aligned columns, one line per block, with the beginning of its problem."""
        return "\n".join(table_lines(self.table()))


def table_lines(rows: Sequence[Row]) -> list[str]:
    """Rows as aligned lines below a header; problems are shortened."""
    cells = [Row._fields, *(_cells(row) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    left = {0, 1, len(widths) - 1}
    return [
        "  ".join(
            c.ljust(w) if k in left else c.rjust(w) for k, (c, w) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in cells
    ]


def _cells(row: Row) -> tuple[str, ...]:
    counts = ["-" if count is None else str(count) for count in row[2:5]]
    sigma0, iterations = ("-" if row.sigma0 is None else f"{row.sigma0:.6g}"), row.iterations
    problem = " ".join(row.problem.split())
    shown = problem if len(problem) <= SHOWN else f"{problem[: SHOWN - 3]}..."
    steps = "-" if iterations is None else str(iterations)
    return row.name, row.status, *counts, sigma0, steps, f"{row.seconds:.2f}", shown


def adjust_many(
    blocks: Mapping[str, Block] | Iterable[Block],
    options: Options | None = None,
    *,
    progress: Callable[[Outcome], None] | None = None,
    **choices: Unpack[Choices],
) -> Batch:
    """Adjusts blocks of any shapes one after the other; options and keywords as for `adjust`.

    Blocks of similar size share their compiled programs. If a block cannot be adjusted, its error is in the result,
    and the others are adjusted. `blocks`: by name, or as a sequence with the names of the blocks; equal names are
    numbered. `progress` is called with each finished block. Ctrl-C ends the batch after the current block, which has
    its last accepted unknowns; a block without an accepted step is left out.

    Raises: TypeError for an unknown option; ValueError for impossible options, or without
    float64.

    Example:
        >>> batch = jb.adjust_many({"quarry": block, "again": block})
        >>> [(outcome.name, outcome.result.success) for outcome in batch.outcomes]
        [('quarry', True), ('again', True)]
    """
    wanted = chosen(options, choices, "adjust_many")
    outcomes: list[Outcome] = []
    for name, block in _named(blocks):
        start = time.perf_counter()
        try:
            result = adjust(block, options=wanted)
        except ValueError as error:
            result = error
        except KeyboardInterrupt:  # before the first accepted step
            break
        outcome = Outcome(name, result, time.perf_counter() - start)
        outcomes.append(outcome)
        if progress is not None:
            progress(outcome)
        if isinstance(result, Adjustment) and result.status is Status.INTERRUPTED:
            break
    return Batch(tuple(outcomes))


def _named(blocks: Any) -> Iterator[tuple[str, Block]]:
    """Iterates over blocks and their names."""
    taken: set[str] = set()
    if isinstance(blocks, Mapping):
        for name, block in blocks.items():
            require_a(Block, block, "adjust")
            yield name, block
        return
    if isinstance(blocks, str | Block) or not isinstance(blocks, Iterable):
        raise TypeError("adjust_many takes several Blocks: call jb.adjust_many([block, ...]) or give a dict of names")
    for block in blocks:
        require_a(Block, block, "adjust")
        name = unique(block.structure.name or "(unnamed)", taken)
        taken.add(name)
        yield name, block


def unique(name: str, taken: set[str]) -> str:
    """The name, with a number appended if it is already used."""
    number, found = 1, name
    while found in taken:
        number += 1
        found = f"{name}-{number}"
    return found
