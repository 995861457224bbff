"""`jaxbundle adjust` of several paths: a folder of results for each, a table of all, and processes that share the work.

A worker process is kept for the next path: it has JAX and its programs already. Only the parent hears of Ctrl-C; it
ends the workers, and reports what they had finished.
"""

import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import NamedTuple

import numpy as np
import typer

from jaxbundle.block.problems import BlockError
from jaxbundle.cli import runtime
from jaxbundle.cli.adjusting import Wanted, adjust_path
from jaxbundle.cli.progress import ProgressLines
from jaxbundle.io.tables import write_table
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.batch import Row, failed_row, row_of, table_lines, unique

TABLE, OUT = "adjustments.csv", Path("adjustments")
NOT_ADJUSTED = "not adjusted"
LISTENING = 0.2  # seconds
GRACE = 2.0  # seconds in which a worker may put away what it was writing; the compiler does not listen


class Task(NamedTuple):
    """A path and what its results are called."""

    name: str
    path: Path
    folder: Path


class Done(NamedTuple):
    """A row of the table and what the path alone would have as exit code."""

    row: Row
    code: int


def run(paths: Sequence[Path], out: Path | None, wanted: Wanted, jobs: int) -> int:
    """Adjusts all, writes and prints; the worst exit code."""
    folder = out or OUT
    _require_place(folder)
    tasks = named(paths, folder)
    not_yet = "it was interrupted before this block was adjusted; run it again"
    done = {task.name: Done(Row(task.name, NOT_ADJUSTED, problem=not_yet), 1) for task in tasks}
    lines = ProgressLines()
    try:
        with lines.phase(f"adjusting {len(tasks)} blocks"):
            for task, result in _in_turn(tasks, wanted) if jobs == 1 else _in_processes(tasks, wanted, jobs):
                done[task.name] = result
                if result.code == 2:
                    typer.echo(f"jaxbundle: {task.path}: {result.row.problem}", err=True)
    except KeyboardInterrupt:
        pass
    rows = [done[task.name].row for task in tasks]
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / TABLE, tasks, rows)
    typer.echo("\n".join(table_lines(rows)))
    typer.echo(f"Results: {folder}")
    return max(result.code for result in done.values())


def named(paths: Sequence[Path], folder: Path) -> list[Task]:
    """A folder for each path, called by its name; equal names are numbered."""
    tasks, taken = [], {TABLE}
    for path in paths:
        name = unique(path.resolve().stem, taken)
        taken.add(name)
        tasks.append(Task(name, path, folder / name))
    return tasks


def adjusted(task: Task, wanted: Wanted) -> Done:
    """One path, whatever is wrong with it."""
    start = time.perf_counter()
    try:
        adjustment = adjust_path(task.path, task.folder, wanted, ProgressLines(quiet=True))
    except (BlockError, OSError, typer.BadParameter) as error:
        return Done(failed_row(task.name, error, time.perf_counter() - start), 2)
    return Done(row_of(task.name, adjustment, time.perf_counter() - start), 0 if adjustment.trustworthy else 1)


def _in_turn(tasks: Sequence[Task], wanted: Wanted) -> Iterator[tuple[Task, Done]]:
    """One after the other, up to one that is interrupted."""
    for task in tasks:
        result = adjusted(task, wanted)
        yield task, result
        if result.row.status == Status.INTERRUPTED.name.lower():
            return


def _in_processes(tasks: Sequence[Task], wanted: Wanted, jobs: int) -> Iterator[tuple[Task, Done]]:
    """By workers, as they finish."""
    jobs = min(jobs, len(tasks))
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # or the workers would outlive their parent
    spawn = multiprocessing.get_context("spawn")  # a fork would share threads of JAX
    with ProcessPoolExecutor(jobs, spawn, _set_up, (jobs,)) as pool:
        try:
            futures: dict[Future[Done], Task] = {pool.submit(adjusted, task, wanted): task for task in tasks}
            while futures:
                # not for ever at once: a signal that another thread receives does not wake one that waits
                finished, _ = wait(futures, LISTENING, FIRST_COMPLETED)
                for future in finished:
                    task = futures.pop(future)
                    yield task, _result(future, task)
        except BaseException:
            workers = list((pool._processes or {}).values())  # a public way comes with Python 3.14
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.terminate()
            multiprocessing.connection.wait([worker.sentinel for worker in workers], GRACE)
            for worker in workers:
                worker.kill()
            raise


def _result(future: Future[Done], task: Task) -> Done:
    try:
        return future.result()
    except BrokenProcessPool:
        what = "a process ended before its time, perhaps for want of memory; run it again with fewer --jobs"
        return Done(Row(task.name, NOT_ADJUSTED, problem=what), 1)


def _set_up(jobs: int) -> None:
    """In a worker: Ctrl-C is the parent's business, and whoever ends the worker shall not leave half a report."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    runtime.start(processes=jobs)


def _require_place(folder: Path) -> None:
    """Raises FileExistsError where the table would overwrite what is no such table."""
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder} is a file; give a folder for the results")
    table = folder / TABLE
    if table.exists() and not table.read_text(encoding="utf-8").startswith("name,path,status,"):
        raise FileExistsError(f"{table} is no table of adjustments; give another folder for the results")


def _write(file: Path, tasks: Sequence[Task], rows: Sequence[Row]) -> None:
    """The table of all, never half of it."""

    def texts(values: Sequence[object]) -> list[str]:
        return ["" if value is None else " ".join(str(value).split()) for value in values]

    columns = dict(zip(Row._fields, map(list, zip(*rows, strict=True)), strict=True))
    with tempfile.TemporaryDirectory(prefix=".jaxbundle-", dir=file.parent) as temporary:
        write_table(
            Path(temporary) / TABLE,
            {
                "name": texts(columns.pop("name")),
                "path": texts([task.path for task in tasks]),
                "status": texts(columns.pop("status")),
                **{name: texts(values) for name, values in columns.items() if name != "seconds"},
                "seconds": np.array(columns["seconds"]),
            },
        )
        os.replace(Path(temporary) / TABLE, file)
