"""Reads many blocks that were made wrong at random: python tests/benchmarks/fuzz_readers.py [--inputs N] [--seed S]

Every input must end in a Block of finite numbers or in a BlockError whose lines can be printed. Counted are both, every
other exception by its place, inputs above the limit of time, and the memory of the process. Forward intersection and
the test of the datum, which are compiled anew for each number of points, run on one input of `--whole`; for the others
missing coordinates are any.
"""

import argparse
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
os.environ.setdefault("POLARS_MAX_THREADS", "1")  # the tables are small

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from cases.mutated_files import bal_mutated, folder_mutated, put  # noqa: E402
from cases.scanned_film import film_folder  # noqa: E402
from cases.small_folder import make_small_folder  # noqa: E402
from cases.surveyed_site import make_surveyed_folder  # noqa: E402

from jaxbundle.block import validate as validation  # noqa: E402
from jaxbundle.block.block import Block  # noqa: E402
from jaxbundle.block.problems import BlockError, is_hidden  # noqa: E402
from jaxbundle.cli import runtime  # noqa: E402
from jaxbundle.io import block_folder, read, read_bal, write_bal  # noqa: E402

LIMIT = 10.0  # seconds of processor time of one input
COMPILING = 60.0  # seconds of processor time of an input whose camera model is met for the first time
WAIT = 60.0  # seconds of any time: a file that never ends
LONG = 2.0  # seconds of processor time that are reported
REPORTED = 5000  # inputs, after each of which a line is printed
SHARES = (0.15, 0.1, 0.05, 0.7)  # of the inputs: of each folder, the cheap ones more, and of BAL files
MESSAGE = 100_000  # characters of all that is told


class HangError(Exception):
    """An input takes longer than the limit."""


def _alarm(*_: object) -> None:
    raise HangError


def timed_outcome(path: Path) -> tuple[str, float]:
    """What came of reading a path, and the processor time; one that compiled programs is read again for its time."""
    for limit in (COMPILING, LIMIT):
        start = time.process_time()
        found = outcome(path, limit)
        used = time.process_time() - start
        if used <= LONG:
            break
    return found, used


def outcome(path: Path, limit: float = LIMIT) -> str:
    """What came of reading a path: "Block", "BlockError", or what should not be."""
    signal.setitimer(signal.ITIMER_PROF, limit)
    signal.setitimer(signal.ITIMER_REAL, WAIT * limit / LIMIT)
    try:
        block = read(path)
        return "Block" if _finite(block) else "Block with numbers that are not finite"
    except BlockError as error:
        text = "\n".join(error.lines)
        told = not any(map(is_hidden, text.replace("\n", ""))) and len(text) < MESSAGE and bool(error.lines)
        return "BlockError" if told else "BlockError that cannot be shown"
    except HangError:
        return "hang"
    except Exception as error:  # every exception is what this looks for
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {str(error)[:80]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)


def _finite(block: Block) -> bool:
    arrays = (
        block.exterior.projection_centre,
        block.exterior.angles,
        block.interior.elements,
        block.rays.coordinates,
        block.rays.sigmas,
        block.object_points,
        *(group.values for group in block.groups),
        *(group.weights for group in block.groups),
    )
    return all(np.isfinite(np.asarray(array)).all() for array in arrays)


def _any_for_missing(block: Block) -> Block:
    points = np.asarray(block.object_points)
    points = np.where(np.isnan(points), np.random.default_rng(0).normal(0, 10, points.shape), points)
    return eqx.tree_at(lambda b: b.object_points, block, jnp.asarray(points))


def _without_datum(block: Block) -> list:
    parts = (validation._unusable_values, validation._unusable_sigmas, validation.weaknesses, validation._redundancy)
    return [problem for part in parts for problem in part(block)]


def fuzz(folder: Path, inputs: int, seed: int, whole: int, shares: Sequence[float] = SHARES) -> Counter[str]:
    """Reads mutations of the blocks in their shares; what is not expected is printed with its number."""
    made = [make(folder / name) for name, make in MAKERS.items()]
    contents = [{path.name: path.read_bytes() for path in sorted(block.iterdir())} for block in made]
    bal = folder / "block.txt"
    write_bal_block(bal)
    numbers = bal.read_bytes()
    true = block_folder.intersect, block_folder.validate
    count: Counter[str] = Counter()
    for number in range(inputs):
        rng = np.random.default_rng([seed, number])
        kind = int(rng.choice(len(shares), p=np.divide(shares, sum(shares))))
        if kind == len(made):
            bal.write_bytes(bal_mutated(numbers, rng))
            path, name = bal, "BAL"
        else:
            path, files = made[kind], contents[kind]
            put(path, folder_mutated(files, rng))
            name = path.name
        plain = number % whole > 0
        block_folder.intersect, block_folder.validate = (_any_for_missing, _without_datum) if plain else true
        found, used = timed_outcome(path)
        count[f"{name}: {found}"] += 1
        if number % REPORTED == REPORTED - 1:
            print(f"{number + 1} inputs read", flush=True)
        if found not in ("Block", "BlockError") or (used > LONG and plain):
            print(f"input {number} ({name}): {found}, {used:.1f} s", flush=True)
        if kind < len(made):
            put(path, dict(contents[kind]))
    block_folder.intersect, block_folder.validate = true
    return count


def write_bal_block(path: Path) -> None:
    """A small BAL file."""
    path.write_text(BAL_TEXT)
    write_bal(read_bal(path), path)


BAL_TEXT = "2 2 4\n0 0 -385.99 387.12\n1 0 -38.44 492.12\n0 1 383.88 -15.3\n1 1 559.75 -106.15\n" + "\n".join(
    map(
        str,
        [0.01, 0.02, -0.003, 1, 2, -3, 1400, 0.001, -2e-4, 0, 0.1, -0.2, 4, 5, 6, 1500, 0, 0, 1, 2, -30, -4, 5, -36],
    )
)
MAKERS = {
    "small": make_small_folder,
    "film": lambda path: film_folder(path, "affine"),
    "surveyed": make_surveyed_folder,
}


def main() -> int:
    """Command line; exit code 1 where an input ended as it should not."""
    parser = argparse.ArgumentParser(description="Reads many blocks that were made wrong at random.")
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--whole", type=int, default=100, help="every so many inputs are intersected and tested")
    parser.add_argument("--shares", type=float, nargs=4, default=SHARES, help="small, film, surveyed folder and BAL")
    options = parser.parse_args()
    runtime.start()
    signal.signal(signal.SIGALRM, _alarm)
    signal.signal(signal.SIGPROF, _alarm)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        count = fuzz(Path(folder), options.inputs, options.seed, options.whole, options.shares)
    used = time.perf_counter() - start
    for what, number in sorted(count.items()):
        print(f"{number:8d}  {what}")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{options.inputs} inputs, {options.inputs / used:.0f} inputs/s, at most {memory:.2f} GiB of memory")
    return int(any(what.split(": ", 1)[1] not in ("Block", "BlockError") for what in count))


if __name__ == "__main__":
    sys.exit(main())
