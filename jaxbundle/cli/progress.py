"""Progress on a terminal: what is being done, and one line an iteration. A pipe or a file gets nothing."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

from jaxbundle.solve.adjust import Progress

HEADER = f"{'iteration':>9}  {'cost':>14}  {'lambda':>8}  {'|Jd|/|v|':>8}  {'sigma0':>10}  {'s':>6}"


class ProgressLines:
    """Writes to standard error, and only where that is a terminal; nothing if `quiet`."""

    def __init__(self, quiet: bool = False) -> None:
        self._console = Console(stderr=True, highlight=False, quiet=quiet)
        self._last = 0.0

    @contextmanager
    def phase(self, what: str) -> Iterator[None]:
        """Shows what is being done for as long as it takes."""
        self._last = time.perf_counter()
        if self._console.is_terminal:
            with self._console.status(what, spinner="line"):
                yield
        else:
            yield

    def iteration(self, progress: Progress) -> None:
        """One line; the first one, which may have waited for the compiler, below a header."""
        if not self._console.is_terminal:
            return
        now = time.perf_counter()
        if progress.iteration == 1:
            self._console.print(HEADER, style="bold")
        self._console.print(
            f"{progress.iteration:>9}  {progress.cost:>14.8g}  {progress.damping:>8.1e}  {progress.step:>8.1e}"
            f"  {progress.sigma0:>10.6g}  {now - self._last:>6.2f}{'' if progress.accepted else '  rejected'}"
        )
        self._last = now
