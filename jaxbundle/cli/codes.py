"""Exit codes of the command line, and the messages of errors."""

import platform
import sys
import tempfile
import traceback
from enum import IntEnum
from importlib.metadata import version

from jaxbundle.block.problems import BlockError
from jaxbundle.imagery.extra import MissingExtraError
from jaxbundle.imagery.image_problems import ImageError

_NO_MEMORY = "RESOURCE_EXHAUSTED"  # the words of JAX
_LESS_MEMORY = (
    "not enough memory; try --no-precision, then --reduced pcg with it, fewer --jobs, or a machine with more memory"
)


class Code(IntEnum):
    """Exit codes of a command; for several blocks the maximum."""

    ADJUSTED = 0
    NOT_TRUSTED = 1
    BAD_INPUT = 2
    NOT_WRITTEN = 3
    UNEXPECTED = 4
    INTERRUPTED = 130  # the code of shells for Ctrl-C


class BadInput(ValueError):
    """Input that cannot be adjusted, with a message."""


class LostProcess(RuntimeError):
    """Another process of the cluster has ended; `error` is the message of JAX."""

    def __init__(self, error: RuntimeError):
        super().__init__(
            f"another process of the cluster was lost ({_first_line(error)}); see its message, and start all processes"
            " again (--checkpoint resumes from the last accepted step)"
        )


def told(error: Exception) -> tuple[Code, str]:
    """The exit code of an error, and its message."""
    if isinstance(error, BlockError | ImageError | MissingExtraError | OSError | BadInput | LostProcess):
        return Code.BAD_INPUT, str(error)
    if isinstance(error, MemoryError) or _NO_MEMORY in str(error):
        return Code.UNEXPECTED, _LESS_MEMORY
    return Code.UNEXPECTED, unexpected(error)


def unexpected(error: Exception) -> str:
    """The message of an internal error; the traceback is written to a file."""
    trace = "".join(traceback.format_exception(error))
    text = f"jaxbundle {version('jaxbundle')}, {platform.platform()}\n{sys.argv}\n\n{trace}"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="jaxbundle-error-", suffix=".txt", delete=False, encoding="utf-8", errors="replace"
        ) as file:
            file.write(text)
        where = file.name
    except OSError:
        sys.stderr.write(text)
        where = "the traceback above"
    what = f"{type(error).__name__}: {_first_line(error)}"
    return f"internal error ({what}); please report it together with {where}"


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0]
