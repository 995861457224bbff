"""Times the adjustment against Ceres and others, in turn on the same blocks: python tests/benchmarks/run.py [FILE ...]

For every block and program: the median time of an iteration, the whole command, peak memory and the cost reached, each
with its ratio to the best of Ceres's solvers in the same column. Our command is `jaxbundle adjust FILE --no-precision`
with its compilation cache filled, from the start of the process to the written tables; Ceres's is its program, from the
start to its report, without a file written. Below our line: the parts of an iteration, each compiled by itself, and the
standard deviations of all images and points. At the end: the growth with the rays.

Without files, generated blocks (48, 110, 320, 1200 images) are timed. The Ceres program is built from the source beside
this file where g++ and Ceres are installed. The peers scipy, gtsam and pycolmap (pip install -e .[benchmarks]) are run
once, where they are installed, each on blocks up to a size of its own. Exit code 1: a program of ours failed.
"""

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

from blocks import SIZES, write_block
from programs import Program, ProgramError, Runner, Timing, build_ceres, size_of, taking_part
from table import print_block, print_growth, print_machine

LARGE = 1_000_000  # rays, from which one round must do
ROUNDS = 3
LONG = 150.0  # seconds of a block, after which no further round begins


def timed_in_turn(programs: dict[str, Program], rounds: int) -> tuple[dict[str, Timing], dict[str, str]]:
    """Medians over rounds in which all take their turn, and why a program has none; one that fails is out."""
    runs: dict[str, list[Timing]] = {name: [] for name in programs}
    failed: dict[str, str] = {}
    start = time.perf_counter()
    for turn in range(rounds):
        if turn and time.perf_counter() - start > LONG:
            break
        for name, program in programs.items():
            if name in failed or (turn and program.once):
                continue
            try:
                if program.warm and turn == 0:
                    program.warm()
                runs[name].append(program.run())
            except ProgramError as error:
                failed[name] = f"{'failed' if not runs[name] else 'failed in a later round'}: {error}"
    medians = {
        name: Timing(*(statistics.median(x) for x in zip(*timings, strict=True)))
        for name, timings in runs.items()
        if timings
    }
    return medians, failed


def compare(runner: Runner, file: Path, rounds: int | None) -> tuple[int, dict[str, Timing], bool]:
    """Times and prints one block. Returns its rays, the medians, and whether our programs did their work."""
    size = size_of(file)
    rounds = rounds or (1 if size[2] > LARGE else ROUNDS)
    results, failed = timed_in_turn(taking_part(runner, file), rounds)
    try:
        parts = runner.parts(file)
    except ProgramError as error:
        parts, failed["parts of an iteration"] = {}, f"failed: {error}"
    print_block(file, size, results, parts, failed)
    return size[2], results, not {"jaxbundle", "parts of an iteration"} & set(failed)


def parsed() -> argparse.Namespace:
    """Options."""
    parser = argparse.ArgumentParser(description="Times the adjustment against Ceres and others on the same blocks.")
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="BAL files instead of generated blocks")
    parser.add_argument("--blocks", default=",".join(SIZES), help="generated blocks, by images (default: %(default)s)")
    parser.add_argument("--rounds", type=int, help=f"default: {ROUNDS}, and 1 above {LARGE} rays")
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds of one program (default: %(default)s)")
    options = parser.parse_args()
    options.blocks = [] if options.files else options.blocks.split(",")
    unknown = [name for name in options.blocks if name not in SIZES]
    if unknown or (options.rounds is not None and options.rounds < 1):
        parser.error(f"no blocks {unknown}; there are {list(SIZES)}" if unknown else "--rounds must be positive")
    return options


def main() -> int:
    """Command line; the exit code."""
    options = parsed()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runner = Runner(folder, options.timeout, build_ceres(folder))
        print_machine(runner.ceres)
        blocks = [compare(runner, file, options.rounds) for file in options.files]
        for block in options.blocks:
            file = folder / f"{block}.txt"
            write_block(file, *SIZES[block])
            blocks.append(compare(runner, file, options.rounds))
            file.unlink()
    print_growth([(rays, results) for rays, results, _ in blocks])
    return 0 if all(fine for *_, fine in blocks) else 1


if __name__ == "__main__":
    sys.exit(main())
