"""Exit codes of the command line, and what is said of an error."""

import platform
import sys
import tempfile
import traceback
from enum import IntEnum
from importlib.metadata import version

from jaxbundle.block.problems import BlockError
from jaxbundle.imagery.extra import MissingExtraError
from jaxbundle.imagery.image_problems import ImageError

_NO_MEMORY = "RESOURCE_EXHAUSTED"  # as JAX says it
_LESS_MEMORY = (
    "not enough memory; try --no-precision, then --reduced pcg with it, fewer --jobs, or a machine with more memory"
)


class Code(IntEnum):
    """How a command ends. Of several blocks the largest counts."""

    ADJUSTED = 0
    NOT_TRUSTED = 1
    BAD_INPUT = 2
    NOT_WRITTEN = 3
    UNEXPECTED = 4
    INTERRUPTED = 130  # as shells have it for Ctrl-C


class BadInput(ValueError):
    """What is given cannot be adjusted, told in a sentence."""


class LostProcess(RuntimeError):
    """Another process of the cluster has ended; `error` is what JAX says of it."""

    def __init__(self, error: RuntimeError):
        super().__init__(
            f"another process of the cluster was lost ({_first_line(error)}); see what it said, and start all of them"
            " again (--checkpoint goes on from the last accepted step)"
        )


def told(error: Exception) -> tuple[Code, str]:
    """The exit code of an error, and the sentence that tells of it."""
    if isinstance(error, BlockError | ImageError | MissingExtraError | OSError | BadInput | LostProcess):
        return Code.BAD_INPUT, str(error)
    if isinstance(error, MemoryError) or _NO_MEMORY in str(error):
        return Code.UNEXPECTED, _LESS_MEMORY
    return Code.UNEXPECTED, unexpected(error)


def unexpected(error: Exception) -> str:
    """One sentence about an error of the program itself; the traceback is kept in a file."""
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
    return f"an error of the program ({what}); please report it together with {where}"


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0]
