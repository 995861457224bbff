"""Adjusts a BAL file on all cores without standard deviations; prints the time of every iteration and the cost."""

import sys
import time

from jaxbundle.cli import runtime

runtime.start()

from jaxbundle.io import read_bal  # noqa: E402
from jaxbundle.solve.adjust import Progress, adjust  # noqa: E402

last = time.perf_counter()


def progress(_: Progress) -> None:
    """Prints the time since the last call."""
    global last
    now = time.perf_counter()
    print("iteration", now - last)
    last = now


result = adjust(read_bal(sys.argv[1]), precision=False, progress=progress)
print("cost", repr(float(result.vtpv) / 2))
