"""Adjusting several paths: one folder of results for each, a table of all, and worker processes.

A worker process is reused for the next path, because it has JAX and the compiled programs in memory. Only the parent
handles Ctrl-C: it ends the workers, and reports the finished blocks.
"""

import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import typer

from jaxbundle.cli import runtime
from jaxbundle.cli.adjusting import Wanted, adjust_path
from jaxbundle.cli.codes import Code, told
from jaxbundle.cli.interruption import Interruption
from jaxbundle.cli.progress import ProgressLines
from jaxbundle.io.tables import write_table
from jaxbundle.numerics.whole_files import marked_name, sync_file
from jaxbundle.report.result_folder import require_writable
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.batch import Row, failed_row, row_of, table_lines, unique

TABLE, OUT = "adjustments.csv", Path("adjustments")
HEADER = b"name,path,status,"  # the first columns of the table
NOT_ADJUSTED = "not adjusted"
LISTENING = 0.2  # seconds
GRACE = 2.0  # seconds for a worker to remove a half-written report; it cannot react during compilation


class Task(NamedTuple):
    """A path and the name of its results."""

    name: str
    path: Path
    folder: Path


class Done(NamedTuple):
    """Result of the adjustment of one path.

    It has the row of the table, the exit code, additional messages, and whether the adjustment was interrupted.
    """

    row: Row
    code: int
    problem: str = ""
    interrupted: bool = False


def run(paths: Sequence[Path], out: Path | None, wanted: Wanted, jobs: int, stop: Interruption) -> int:
    """Adjusts all paths, writes and prints, and returns the maximum exit code."""
    folder = out or OUT
    _require_place(folder)
    tasks = named(paths, folder)
    not_yet = "it was interrupted before this block was adjusted; run it again"
    done = {task.name: Done(Row(task.name, NOT_ADJUSTED, problem=not_yet), Code.INTERRUPTED) for task in tasks}
    lines = ProgressLines()
    results = _in_turn(tasks, wanted, stop) if jobs == 1 else _in_processes(tasks, wanted, jobs, stop)
    try:
        with lines.phase(f"adjusting {len(tasks)} blocks"):
            for task, result in results:
                done[task.name] = result
                if result.problem:
                    typer.echo(f"jaxbundle: {task.path}: {result.problem}", err=True)
    except KeyboardInterrupt:
        pass
    stop.finish()
    code = max(result.code for result in done.values())
    return max(code, _written(folder, tasks, [done[task.name].row for task in tasks]))


def _written(folder: Path, tasks: Sequence[Task], rows: Sequence[Row]) -> Code:
    """Writes and prints the table of all paths."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write(folder / TABLE, tasks, rows)
        code = Code.ADJUSTED
    except OSError as error:
        typer.echo(f"jaxbundle: {folder / TABLE} cannot be written: {error}", err=True)
        code = Code.NOT_WRITTEN
    typer.echo("\n".join(table_lines(rows)))
    typer.echo(f"Results: {folder}")
    return code


def named(paths: Sequence[Path], folder: Path) -> list[Task]:
    """A folder for each path with its name; equal names are numbered."""
    tasks, taken = [], {TABLE}
    for path in paths:
        name = unique(path.resolve().stem, taken)
        taken.add(name)
        tasks.append(Task(name, path, folder / name))
    return tasks


def adjusted(task: Task, wanted: Wanted, stop: Interruption | None = None) -> Done:
    """Adjusts one path and catches all errors."""
    start = time.perf_counter()
    try:
        outcome = adjust_path(task.path, task.folder, wanted, ProgressLines(quiet=True), stop or Interruption())
    except typer.BadParameter as error:
        return Done(failed_row(task.name, error, time.perf_counter() - start), Code.BAD_INPUT, str(error))
    except Exception as error:
        code, words = told(error)
        seconds = time.perf_counter() - start
        if code is Code.BAD_INPUT:
            return Done(failed_row(task.name, error, seconds), code, words)
        return Done(Row(task.name, NOT_ADJUSTED, seconds=seconds, problem=words), code, words)
    row = row_of(task.name, outcome.adjustment, time.perf_counter() - start)
    problems = [problem for problem in (outcome.problem, row.problem) if problem]
    interrupted = outcome.adjustment.status is Status.INTERRUPTED
    return Done(row._replace(problem="; ".join(problems)), outcome.code, outcome.problem, interrupted)


def _in_turn(tasks: Sequence[Task], wanted: Wanted, stop: Interruption) -> Iterator[tuple[Task, Done]]:
    """Adjusts one path after the other, until one is interrupted."""
    for task in tasks:
        result = adjusted(task, wanted, stop)
        yield task, result
        if result.interrupted or stop.wanted:
            return


def _in_processes(tasks: Sequence[Task], wanted: Wanted, jobs: int, stop: Interruption) -> Iterator[tuple[Task, Done]]:
    """Adjusts with worker processes; yields results as they finish."""
    jobs = min(jobs, len(tasks))
    # read by numpy when a worker starts: threads of BLAS that wait for a core of another worker waste its time
    os.environ.setdefault("OPENBLAS_NUM_THREADS", str(max(1, runtime.cores() // jobs)))
    spawn = multiprocessing.get_context("spawn")  # forked processes would share threads of JAX
    with ProcessPoolExecutor(jobs, spawn, _set_up, (jobs,)) as pool:
        stop.before_the_end = lambda: _kill(pool)  # otherwise the workers would outlive their parent
        try:
            futures: dict[Future[Done], Task] = {pool.submit(adjusted, task, wanted): task for task in tasks}
            while futures:
                # with a time limit: a signal to another thread does not wake a waiting thread
                finished, _ = wait(futures, LISTENING, FIRST_COMPLETED)
                stop.check()
                for future in finished:
                    task = futures.pop(future)
                    yield task, _result(future, task)
        except BaseException:
            workers = _workers(pool)
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.terminate()
            multiprocessing.connection.wait([worker.sentinel for worker in workers], GRACE)
            for worker in workers:
                worker.kill()
            raise


def _workers(pool: ProcessPoolExecutor) -> list[Any]:
    return list((pool._processes or {}).values())  # Python 3.14 has a public function for it


def _kill(pool: ProcessPoolExecutor) -> None:
    for worker in _workers(pool):
        worker.kill()


def _result(future: Future[Done], task: Task) -> Done:
    try:
        return future.result()
    except BrokenProcessPool:
        what = "a process ended unexpectedly, perhaps because of too little memory; run it again with fewer --jobs"
        return Done(Row(task.name, NOT_ADJUSTED, problem=what), Code.UNEXPECTED, what)


def _set_up(jobs: int) -> None:
    """Set-up of a worker: the parent handles Ctrl-C, and the end of a worker must not leave a half-written report."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    runtime.start(processes=jobs)


def _require_place(folder: Path) -> None:
    """Raises an OSError if the table cannot be written, or would overwrite another file."""
    require_writable(folder, [], 0)
    table = folder / TABLE
    if os.path.lexists(table) and not _is_table(table):
        raise FileExistsError(f"{table} is not a table of adjustments; give another folder for the results (--out)")


def _is_table(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(HEADER)) == HEADER
    except OSError:
        return False


def _write(file: Path, tasks: Sequence[Task], rows: Sequence[Row]) -> None:
    """Writes the table of all paths, never half-written."""

    def texts(values: Sequence[object]) -> list[str]:
        return ["" if value is None else " ".join(str(value).split()) for value in values]

    columns = dict(zip(Row._fields, map(list, zip(*rows, strict=True)), strict=True))
    beside = file.with_name(marked_name())
    try:
        write_table(
            beside,
            {
                "name": texts(columns.pop("name")),
                "path": texts([task.path for task in tasks]),
                "status": texts(columns.pop("status")),
                **{name: texts(values) for name, values in columns.items() if name != "seconds"},
                "seconds": np.array(columns["seconds"]),
            },
        )
        sync_file(beside)
        os.replace(beside, file)
    finally:
        beside.unlink(missing_ok=True)
