"""The programs that take part, each started as a process of its own: what it printed, how long and how much it took."""

import contextlib
import importlib.util
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
SOLVERS = ("dense_schur", "sparse_schur")
MAX_DENSE = 600  # images: beyond, Ceres's dense matrix takes gigabytes
PEERS = {"scipy": 50_000, "gtsam": 50_000, "pycolmap": 1_000_000}  # rays that each is asked to take
TOLERANCE = "1e-12"  # of Ceres's cost
CERES_ROW = r"^ +\d+ +\S+ +\S+ +\S+ +\S+ +\S+ +\S+ +\d+ +(\S+) +\S+$"  # iteration to total time; takes iter_time


class ProgramError(Exception):
    """A program that failed, took too long or printed something else than expected."""


class Timing(NamedTuple):
    """Median iteration and whole command in seconds, peak memory in MB, cost reached."""

    iteration: float
    command: float
    memory: float
    cost: float


class Program(NamedTuple):
    """A program on one block: `warm` fills its caches and is not timed, a peer runs once."""

    run: Callable[[], Timing]
    warm: Callable[[], object] | None = None
    once: bool = False


class Runner(NamedTuple):
    """Starts programs; each is ended after `timeout` seconds. `ceres`: its program, None where it cannot be built."""

    folder: Path
    timeout: float
    ceres: Path | None

    def measured(self, command: Iterable[object], allowed: tuple[int, ...] = (0,)) -> tuple[str, float, float]:
        """Output, wall time in seconds and peak memory in MB of a command.

        Raises: ProgramError for another exit code than the allowed ones, and after the timeout.
        """
        # time(1) starts the command from a small process: a child of this one would inherit its peak
        timed = ["/usr/bin/time", "-f", "peak %M"] if Path("/usr/bin/time").exists() else []
        start = time.perf_counter()
        out, err, code = _output([*timed, *map(str, command)], self.timeout)
        wall = time.perf_counter() - start
        if code not in allowed:
            lines = [line for line in (out + err).splitlines() if line.strip() and not line.startswith("peak ")]
            raise ProgramError(f"exit code {code}: {lines[-1] if lines else 'no output'}")
        peak = re.findall(r"^peak (\d+)", err, re.M)
        return out, wall, int(peak[-1]) / 1024 if peak else float("nan")

    def worker(self, name: str, file: Path, *options: object) -> tuple[str, float, float]:
        """A program of this folder."""
        return self.measured([sys.executable, HERE / f"{name}_worker.py", file, *options])

    def peer(self, name: str, file: Path) -> Timing:
        """A peer's worker prints its own iteration times or Ceres's table, and the cost."""
        out, wall, memory = self.worker(name, file, *([CORES] if name == "pycolmap" else []))
        return Timing(_iteration(out), wall, memory, _cost(out))

    def ceres_solver(self, file: Path, solver: str) -> Timing:
        """Ceres on all cores."""
        out, wall, memory = self.measured([self.ceres, file, solver, CORES, 100, TOLERANCE])
        return Timing(_iteration(out), wall, memory, _cost(out))

    def adjust(self, file: Path, *options: object, allowed: tuple[int, ...] = (0,)) -> tuple[str, float, float]:
        """The command line of jaxbundle, reading and writing included."""
        script = shutil.which("jaxbundle", path=str(Path(sys.executable).parent)) or shutil.which("jaxbundle")
        if script is None:
            raise ProgramError("there is no command jaxbundle; install the package")
        out = self.folder / f"{file.stem}-adjusted"
        try:
            return self.measured([script, "adjust", file, "--no-precision", "--out", out, *options], allowed)
        finally:
            shutil.rmtree(out, ignore_errors=True)

    def jaxbundle(self, file: Path) -> Timing:
        """Iterations and cost from the worker, wall time and memory from the command line."""
        printed, *_ = self.worker("jaxbundle", file)
        _, wall, memory = self.adjust(file)
        return Timing(_iteration(printed), wall, memory, _cost(printed))

    def parts(self, file: Path) -> dict[str, float]:
        """Seconds of the parts of a step of jaxbundle, and of its cofactors, by name."""
        out, *_ = self.worker("parts", file)
        return {name: float(seconds) for name, seconds in re.findall(r"^part (.+) (\S+)$", out, re.M)}


def _output(command: list[str], timeout: float) -> tuple[str, str, int]:
    """What a command printed, and its exit code; after the timeout it is ended with all processes it has started."""
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired as error:
        raise ProgramError(f"took longer than {timeout:.0f} s") from error
    finally:
        if process.poll() is None:  # also after Ctrl-C, which a session of its own does not get
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    return out, err, process.returncode


def _iteration(out: str) -> float:
    """Median time; the first iteration, which waits for the compiler or the symbolic analysis, is left out."""
    own = [float(x) for x in re.findall(r"^iteration (\S+)", out, re.M)]
    rows = own or [float(x) for x in re.findall(CERES_ROW, out, re.M)[1:]]  # row 0 is the start
    if not rows:
        raise ProgramError("it printed no iteration")
    return statistics.median(rows[1:] or rows)


def _cost(out: str) -> float:
    costs = re.findall(r"^(?:final )?cost (\S+)", out, re.M)
    if len(costs) != 1:
        raise ProgramError(f"it printed {len(costs)} costs")
    return float(costs[0])


def build_ceres(folder: Path) -> Path | None:
    """The Ceres program, None where it cannot be built."""
    if not shutil.which("g++"):
        return None
    program = folder / "ceres_bundle"
    build = ["g++", "-O3", "-march=native", "-std=c++17", "-I/usr/include/eigen3", str(HERE / "ceres_bundle.cc")]
    done = subprocess.run([*build, "-o", str(program), "-lceres", "-lglog"], capture_output=True, check=False)
    return program if done.returncode == 0 else None


def taking_part(runner: Runner, file: Path) -> dict[str, Program]:
    """The programs that are asked to take a block, by name."""
    images, _, rays = size_of(file)
    programs = {
        "jaxbundle": Program(
            lambda: runner.jaxbundle(file),
            lambda: runner.adjust(file, "--max-iterations", 1, allowed=(0, 1)),
        )
    }
    if runner.ceres:
        for solver in SOLVERS[images > MAX_DENSE :]:
            programs[f"Ceres {solver}"] = Program(lambda solver=solver: runner.ceres_solver(file, solver))
    for peer, largest in PEERS.items():
        if rays <= largest and importlib.util.find_spec(peer):
            programs[peer] = Program(lambda peer=peer: runner.peer(peer, file), once=True)
    return programs


def size_of(file: Path) -> tuple[int, int, int]:
    """Images, points and rays of a BAL file."""
    with file.open() as lines:
        images, points, rays = map(int, lines.readline().split())
    return images, points, rays


def versions(ceres: Path | None) -> dict[str, str]:
    """Version of every program, or that it is not there."""
    found = {"python": sys.version.split()[0]}
    for name in ("jaxbundle", "jax", *PEERS):
        found[name] = version(name) if importlib.util.find_spec(name) else "not installed"
    told = subprocess.run([str(ceres)], capture_output=True, text=True, check=False).stdout.strip() if ceres else ""
    return {**found, "Ceres": told or "not built"}
