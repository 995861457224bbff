"""The end of a process whose cluster is gone, in a sentence.

JAX ends a process that lost its coordinator from a thread of C++: it writes a line and a stack to standard error and
aborts. No exception comes of it. So standard error is passed on by a thread of our own, which ends the process at that
line.
"""

import os
from collections.abc import Callable
from threading import Thread

from jaxbundle.cli.codes import Code

_FATAL = b"the JAX distributed service detected fatal errors"
_BEFORE = b"coordination_service_agent"  # the lines that announce it
_SENTENCE = (
    b"jaxbundle: another process of the cluster was lost, or process 0, the coordinator; see what it said, and start"
    b" all of them again (--checkpoint goes on from the last accepted step)\n"
)


def in_a_sentence() -> Callable[[], None]:
    """Begins to pass on standard error, and returns a function that brings it back as it was."""
    read, write = os.pipe()
    kept = os.dup(2)
    os.dup2(write, 2)
    os.close(write)
    thread = Thread(target=_pass_on, args=(read, kept), daemon=True)
    thread.start()

    def end() -> None:
        os.dup2(kept, 2)  # the last end of the pipe: the thread comes to its end
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
