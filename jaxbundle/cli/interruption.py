"""Immediate response to Ctrl-C and SIGTERM.

Python runs signal handlers between two of its instructions, and one call of JAX's compiler may take a minute. Therefore
a thread reads the file descriptor to which the low-level handler writes. It prints a message immediately, and at the
second signal it ends the process. The first signal sets a flag that is checked after each iteration: an exception alone
may be lost, for example in a callback of the garbage collector.
"""

import os
import signal
import time
from collections.abc import Callable
from threading import Thread, current_thread, main_thread
from types import FrameType
from typing import Any, Self

from jaxbundle.cli.codes import Code

_SIGNALS = signal.SIGINT, signal.SIGTERM
_ONE = 0.5  # seconds: a terminal and a parent process may both forward the same Ctrl-C
_STOPPING = "stopping after this step; Ctrl-C again stops immediately"
_WRITING = "the results are being written; Ctrl-C again stops immediately, without them"


def _nothing() -> None:
    """The default function before the process ends: nothing to do."""


class Interruption:
    """Context that handles signals in the main thread of a process.

    Before the first accepted iteration a signal raises KeyboardInterrupt; after it the iterations end, and their result
    is written.
    """

    def __init__(self) -> None:
        self.wanted = False
        self.before_the_end: Callable[[], object] = _nothing  # called before the second signal ends the process
        self._keeps, self._words = False, _STOPPING
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if current_thread() is main_thread():
            self._read, self._write = os.pipe()
            os.set_blocking(self._write, False)
            Thread(target=self._answer, daemon=True).start()
            # a process that was started in the background may ignore Ctrl-C
            heard = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
            self._wakeup = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
            self._handlers = {number: signal.signal(number, self._hear) for number in heard}
        return self

    def __exit__(self, *_: object) -> None:
        if current_thread() is main_thread():
            for number, handler in self._handlers.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(self._wakeup)
            os.close(self._write)  # ends the thread

    def begin(self) -> None:
        """Marks the begin of a block, which has no results yet.

        Raises: KeyboardInterrupt where the user wants to stop.
        """
        self._keeps, self._words = False, _STOPPING
        self.check()

    def check(self) -> None:
        """Raises KeyboardInterrupt where the user wants to stop."""
        if self.wanted:
            raise KeyboardInterrupt

    def step(self, accepted: bool) -> None:
        """Marks the end of an iteration.

        Raises: KeyboardInterrupt where the user wants to stop.
        """
        self._keeps |= accepted
        self.check()

    def finish(self) -> None:
        """Marks the end of the adjustment; the first signal no longer interrupts."""
        self._keeps, self._words = True, _WRITING

    def _hear(self, _number: int, _frame: FrameType | None) -> None:
        self.wanted = True
        if not self._keeps:
            raise KeyboardInterrupt

    def _answer(self) -> None:
        first = None
        while heard := os.read(self._read, 1):
            if heard[0] not in _SIGNALS:
                continue
            if first is None:
                first = time.monotonic()
                _say(self._words)
            elif time.monotonic() - first > _ONE:
                try:
                    self.before_the_end()
                finally:
                    os._exit(Code.INTERRUPTED)
        os.close(self._read)


def _say(words: str) -> None:
    """Writes to standard error without Python's buffers and locks."""
    try:
        os.write(2, f"\njaxbundle: {words}\n".encode())
    except OSError:
        pass  # standard error is closed
