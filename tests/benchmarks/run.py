"""Times the adjustment against Ceres and others, in turn on the same blocks: python tests/benchmarks/run.py [FILE ...]

Prints for every block and program the median time of one iteration, the whole command, peak memory, the cost reached
and the ratio of the iteration to that of the fastest of Ceres's solvers; at the end the growth of time and memory with
the rays. Without files three generated blocks (48, 320, 1200 images) are timed. The Ceres program is built from the
source beside this file where g++ and Ceres are installed; gtsam takes part where it is installed, it and scipy on small
blocks.
"""

import argparse
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from blocks import SIZES, write_block

HERE = Path(__file__).parent
SOLVERS = ("dense_schur", "sparse_schur")
LARGEST_DENSE = 600  # images: beyond, Ceres's dense matrix takes gigabytes
LARGEST_PEER = 50_000  # rays that scipy and gtsam are asked to take


class Timing(NamedTuple):
    """Median iteration and whole command in seconds, peak memory in MB, cost reached."""

    iteration: float
    command: float
    memory: float
    cost: float


def measured(command: list[str]) -> tuple[str, float, float]:
    """Output, wall time and peak memory of a command."""
    start = time.perf_counter()
    timed = ["/usr/bin/time", "-f", "peak %M"] if Path("/usr/bin/time").exists() else []
    done = subprocess.run([*timed, *command], capture_output=True, text=True, check=False)
    wall = time.perf_counter() - start
    if done.returncode not in (0, 1):
        raise RuntimeError(done.stdout + done.stderr)
    peak = re.search(r"peak (\d+)", done.stderr)
    return done.stdout, wall, int(peak[1]) / 1024 if peak else float("nan")


def timed_worker(worker: str, file: Path) -> Timing:
    """A program of this folder that prints `iteration`, `cost` lines."""
    out, wall, memory = measured([sys.executable, str(HERE / f"{worker}_worker.py"), str(file)])
    iterations = [float(x) for x in re.findall(r"^iteration (\S+)", out, re.M)]
    (cost,) = re.findall(r"^cost (\S+)", out, re.M)
    return Timing(statistics.median(iterations[1:] or iterations), wall, memory, float(cost))


def ceres(program: Path, file: Path, solver: str, tolerance: float = 1e-12) -> Timing:
    """Ceres on two threads."""
    out, wall, memory = measured([str(program), str(file), solver, "2", "100", str(tolerance)])
    rows = re.findall(r"^ +\d+ +\S+ +\S+ +\S+ +\S+ +\S+ +\S+ +\d+ +(\S+) +\S+$", out, re.M)
    (cost,) = re.findall(r"^final cost (\S+)", out, re.M)
    return Timing(statistics.median(float(x) for x in rows[2:]), wall, memory, float(cost))


def build_ceres(folder: Path) -> Path | None:
    """The Ceres program, None where it cannot be built."""
    if not shutil.which("g++"):
        return None
    program = folder / "ceres_bundle"
    build = ["g++", "-O3", "-march=native", "-std=c++17", "-I/usr/include/eigen3", str(HERE / "ceres_bundle.cc")]
    done = subprocess.run([*build, "-o", str(program), "-lceres", "-lglog"], capture_output=True, check=False)
    return program if done.returncode == 0 else None


def compare(file: Path, program: Path | None, rounds: int) -> tuple[int, Timing]:
    """Prints one block's lines: medians over rounds in which all take their turn. Returns the rays and our line."""
    images, points, rays = map(int, file.open().readline().split())
    peers: dict[str, Callable[[], Timing]] = {"jaxbundle": lambda: timed_worker("jaxbundle", file)}
    if program:
        for solver in SOLVERS[images > LARGEST_DENSE :]:
            peers[f"Ceres {solver}"] = lambda solver=solver: ceres(program, file, solver)
    if rays <= LARGEST_PEER:
        peers["scipy"] = lambda: timed_worker("scipy", file)
        peers["gtsam"] = lambda: timed_worker("gtsam", file)
    results: dict[str, list[Timing]] = {name: [] for name in peers}
    for turn in range(rounds + 1):
        for name, run in peers.items():
            if turn > 1 and name in ("scipy", "gtsam"):
                continue
            try:
                timing = run()
            except (RuntimeError, ValueError):
                continue
            if turn or name != "jaxbundle":  # its first turn fills the compilation cache
                results[name].append(timing)
    print(f"\n{file.name}: {images} images, {points} points, {rays} rays")
    medians = {
        name: Timing(*(statistics.median(x) for x in zip(*runs, strict=True))) for name, runs in results.items() if runs
    }
    best = min((t.iteration for name, t in medians.items() if name.startswith("Ceres")), default=float("nan"))
    for name, t in medians.items():
        print(
            f"  {name:20s} iteration {1e3 * t.iteration:9.1f} ms  command {t.command:7.2f} s  peak {t.memory:6.0f} MB"
            f"  cost {t.cost:.9e}  ratio {t.iteration / best:5.2f}"
        )
    return rays, medians["jaxbundle"]


def print_growth(results: list[tuple[int, Timing]]) -> None:
    """Exponents of time and memory in the rays, by a straight line through the logarithms."""
    if len(results) < 3:
        return
    rays = np.log([n for n, _ in results])
    for name in ("iteration", "command", "memory"):
        exponent = np.polyfit(rays, np.log([getattr(t, name) for _, t in results]), 1)[0]
        print(f"{name} grows with the rays to the power {exponent:.2f}")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        files: list[Path] = options.files
        for name, size in [] if options.files else list(SIZES.items()):
            files = [*files, Path(folder) / f"{name}.txt"]
            write_block(files[-1], *size)
        program = build_ceres(Path(folder))
        print_growth([compare(file, program, options.rounds) for file in files])


if __name__ == "__main__":
    main()
