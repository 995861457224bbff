"""Ending a process with a message when its cluster is lost.

JAX ends a process that lost its coordinator from a thread in C++: it writes a line and a stack trace to standard error
and aborts, without an exception. Therefore our own thread forwards standard error, and ends the process when it reads
that line.
"""

import os
from collections.abc import Callable
from threading import Thread

from jaxbundle.cli.codes import Code

_FATAL = b"the JAX distributed service detected fatal errors"
_BEFORE = b"coordination_service_agent"  # lines that precede it
_SENTENCE = (
    b"jaxbundle: another process of the cluster was lost, or process 0, the coordinator; see its message, and start"
    b" all processes again (--checkpoint resumes from the last accepted step)\n"
)


def in_a_sentence() -> Callable[[], None]:
    """Starts to forward standard error, and returns a function that restores it."""
    read, write = os.pipe()
    kept = os.dup(2)
    os.dup2(write, 2)
    os.close(write)
    thread = Thread(target=_pass_on, args=(read, kept), daemon=True)
    thread.start()

    def end() -> None:
        os.dup2(kept, 2)  # closes the last writing end of the pipe: the thread ends
        thread.join()
        os.close(kept)

    return end


def _pass_on(read: int, target: int) -> None:
    with os.fdopen(read, "rb") as lines:
        for line in lines:
            if _FATAL in line:
                os.write(target, _SENTENCE)
                os._exit(Code.BAD_INPUT)
            if _BEFORE not in line:
                os.write(target, line)
