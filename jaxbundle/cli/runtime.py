"""JAX as the command line needs it: double precision, one device per core, compiled programs kept for the next call."""

import atexit
import os
import sys
from collections.abc import Callable
from threading import Timer

import jax
import typer

from jaxbundle.cli.cluster import AUTOMATIC, Cluster
from jaxbundle.cli.codes import Code, LostProcess
from jaxbundle.cli.last_words import in_a_sentence
from jaxbundle.numerics.devices import meet
from jaxbundle.numerics.program_cache import keep_programs

MOST_DEVICES = 8  # each holds the reduced normal equations in full
MEETING, LOST, WRITING = 120, 60, 3600  # seconds: to wait for all processes, for a silent one, for the report


def start(cluster: Cluster | None = None, processes: int = 1) -> None:
    """To be called before anything is computed. `cluster`: that this process belongs to; `processes` share the cores.

    Raises: typer.BadParameter for a cluster that cannot be joined.
    """
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", max(1, min(_cores() // processes, MOST_DEVICES)))
    keep_programs()
    if cluster is not None:
        _join(cluster)


def _join(cluster: Cluster) -> None:
    """Meets the other processes. From then on a process that fails ends at once: the others are told."""
    jax.config.update("jax_enable_preemption_service", False)  # it would take SIGTERM for a notice
    waiting = Timer(MEETING, _not_met, [cluster])
    waiting.daemon = True
    waiting.start()
    try:
        jax.distributed.initialize(
            None if cluster.coordinator == AUTOMATIC else cluster.coordinator,
            cluster.processes,
            cluster.process,
            initialization_timeout=2 * MEETING,  # longer than our own, for JAX ends the process without a word of ours
            heartbeat_timeout_seconds=LOST,
            shutdown_timeout_seconds=WRITING,
        )
    except ValueError as error:
        cure = "give HOST:PORT with --processes and --process" if cluster.coordinator == AUTOMATIC else "check it"
        raise typer.BadParameter(f"--coordinator {cluster.coordinator}: no cluster ({error}); {cure}") from error
    finally:
        waiting.cancel()
    restored = in_a_sentence()
    atexit.register(restored)
    _require_count(cluster)
    try:
        meet()
    except RuntimeError as error:
        raise LostProcess(error) from error
    atexit.register(_end_at_once, restored)  # runs before JAX's own, which waits for the other processes


def _require_count(cluster: Cluster) -> None:
    """Raises typer.BadParameter where process 0 was told another number of processes than this one."""
    if cluster.processes is not None and jax.process_count() != cluster.processes:
        raise typer.BadParameter(
            f"--processes {cluster.processes} here, but process 0 was told {jax.process_count()}; give all the same"
        )


def _not_met(cluster: Cluster) -> None:
    address, count, number = cluster
    who = "process" if number is None else f"process {number} of {count}"
    typer.echo(
        f"jaxbundle: {who} did not meet all others at {address} in {MEETING} s; start process 0 on that machine and one"
        " process of every number with the same --coordinator and --processes, and let the port through the firewall",
        err=True,
    )
    os._exit(2)


def finished() -> None:
    """The work is done: this process may end when the others do."""
    atexit.unregister(_end_at_once)


def _end_at_once(before: Callable[[], None]) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    before()
    os._exit(Code.BAD_INPUT)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
