"""Progress on a terminal: the current phase, and one line per iteration. Pipes and files get no output."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.status import Status

from jaxbundle.solve.adjust import Progress

HEADER = f"{'iteration':>9}  {'cost':>14}  {'lambda':>8}  {'|Jd|/|v|':>8}  {'sigma0':>10}  {'s':>6}"

COMPILING = "planning and compiling (the first time takes up to a minute)"
_ADJUSTING = "adjusting"
_PRECISION = "standard deviations"
_LONG = 1.0  # seconds: a phase that took longer is listed with its time


class ProgressLines:
    """Writes progress to standard error if that is a terminal and `quiet` is false."""

    def __init__(self, quiet: bool = False) -> None:
        self._console = Console(stderr=True, highlight=False, quiet=quiet)
        self._last = 0.0
        self._status: Status | None = None

    @contextmanager
    def phase(self, what: str) -> Iterator[None]:
        """Context that shows a phase while it runs."""
        begin = self._last = time.perf_counter()
        if self._console.is_terminal:
            with self._console.status(what, spinner="line") as self._status:
                yield
            self._status = None
            took = time.perf_counter() - begin
            if took > _LONG:
                name = _ADJUSTING if what == COMPILING else what
                self._console.print(f"{name}: {took:.1f} s in total", style="dim")
        else:
            yield

    def iteration(self, progress: Progress) -> None:
        """Prints the line of an iteration; the first one, which may include compilation, with a header."""
        if not self._console.is_terminal:
            return
        now = time.perf_counter()
        if progress.iteration == 1:
            self._console.print(HEADER, style="bold")
        if self._status is not None:
            self._status.update(_ADJUSTING)
        self._console.print(
            f"{progress.iteration:>9}  {_known(progress.cost, '.8g'):>14}  {_known(progress.damping, '.1e'):>8}"
            f"  {_known(progress.step, '.1e'):>8}  {_known(progress.sigma0, '.6g'):>10}  {now - self._last:>6.2f}"
            f"{'' if progress.accepted else '  rejected'}"
        )
        self._last = now
        if progress.ended and self._status is not None:
            self._status.update(_PRECISION)


class Phases:
    """The current phase on one line of standard error; no output if that is not a terminal."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._status: Status | None = None

    def __enter__(self) -> "Phases":
        if self._console.is_terminal:
            self._status = self._console.status("", spinner="line")
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def tell(self, what: str) -> None:
        """Shows the current phase."""
        if self._status is not None:
            self._status.update(what)


def _known(value: float, form: str) -> str:
    """A number as text, "-" for NaN."""
    return "-" if math.isnan(value) else format(value, form)
