"""Progress on a terminal: the phase, one line per iteration, and the time left. Pipes and files get no output."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.status import Status

from jaxbundle.solve.adjust import Phase, Progress
from jaxbundle.solve.stopping_rules import AbstractStoppingRule, AngleRule

HEADER = f"{'iteration':>9}  {'cost':>14}  {'lambda':>8}  {'|Jd|/|v|':>8}  {'sigma0':>10}  {'s':>6}"

_LONG = 1.0  # seconds: a phase that took longer is listed with its time
_WORTH_TELLING = 5.0  # seconds: a shorter remaining time is not shown
_RATIOS = 3  # number of ratios of successive steps for the extrapolation of the next ones
_MORE: dict[str, str] = {"compiling": "compiling (the first time takes up to a minute)"}


class ProgressLines:
    """Writes progress to standard error if that is a terminal and `quiet` is false.

    `rule`: the stopping rule, by which the time left is estimated.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._console = Console(stderr=True, highlight=False, quiet=quiet)
        self._last = self._begin = 0.0
        self._status: Status | None = None
        self._what = ""
        self._steps: list[float] = []
        self.rule: AbstractStoppingRule | None = None

    @contextmanager
    def phase(self, what: str) -> Iterator[None]:
        """Context that shows a phase while it runs; `begins` names phases within it."""
        self._what, self._begin = what, time.perf_counter()
        self._last, self._steps = self._begin, []
        if self._console.is_terminal:
            with self._console.status(what, spinner="line") as self._status:
                yield
            self._status = None
            self._list()
        else:
            yield

    def begins(self, what: Phase) -> None:
        """The adjustment comes to a phase."""
        if self._status is None:
            return
        self._list()
        self._what, self._begin = what, time.perf_counter()
        self._status.update(_MORE.get(what, what))

    def iteration(self, progress: Progress) -> None:
        """Prints the line of an iteration; the first one, which may include compilation, with a header."""
        if not self._console.is_terminal:
            return
        now = time.perf_counter()
        if progress.iteration == 1:
            self._console.print(HEADER, style="bold")
            self._steps = []
        self._console.print(
            f"{progress.iteration:>9}  {_known(progress.cost, '.8g'):>14}  {_known(progress.damping, '.1e'):>8}"
            f"  {_known(progress.step, '.1e'):>8}  {_known(progress.sigma0, '.6g'):>10}  {now - self._last:>6.2f}"
            f"{'' if progress.accepted else '  rejected'}"
        )
        if progress.accepted:
            self._steps.append(progress.step)
        if self._status is not None and not progress.ended:
            left = iterations_left(self._steps, self.rule)
            self._status.update("iterating" + told_left(left, now - self._last if progress.iteration > 1 else 0.0))
        self._last = now

    def _list(self) -> None:
        """A line for a phase that took long."""
        took = time.perf_counter() - self._begin
        if took > _LONG and self._what:
            self._console.print(f"{self._what}: {took:.1f} s", style="dim")


def iterations_left(steps: list[float], rule: AbstractStoppingRule | None) -> int | None:
    """Number of remaining accepted iterations until the rule is met, if the steps continue to decrease as before.

    Args:
        steps: |J d| / |v| of the accepted iterations so far.
        rule: the stopping rule; only the rule of the angle is one of these steps.

    Returns: the number, at least 1; None if it cannot be estimated: another rule, or steps that do not decrease.
    """
    known = [step for step in steps if math.isfinite(step) and step > 0]
    if not isinstance(rule, AngleRule) or len(known) < 2 or not rule.limit > 0:
        return None
    last = known[-_RATIOS - 1 :]
    fall = (math.log(last[0]) - math.log(last[-1])) / (len(last) - 1)
    if fall <= 0:
        return None
    return max(1, math.ceil((math.log(known[-1]) - math.log(rule.limit)) / fall - 1e-9))


def told_left(iterations: int | None, seconds: float) -> str:
    """Words for the remaining iterations and their time; empty if the time is short."""
    if iterations is None or iterations * seconds < _WORTH_TELLING:
        return ""
    total = iterations * seconds
    words = f"{total:.0f} s" if total < 100 else f"{total / 60:.0f} min"
    one = "iteration" if iterations == 1 else "iterations"
    return f", about {words} left ({iterations} {one} of {seconds:.1f} s), then standard deviations"


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
