"""Set-up of JAX for the command line: double precision, one device per core, compiled programs cached on disk."""

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
from jaxbundle.numerics.devices import cores, meet
from jaxbundle.numerics.program_cache import keep_programs

MAX_DEVICES = 8  # each device stores the full reduced normal equations
MEETING, LOST, WRITING = 120, 60, 3600  # seconds: waiting for all processes, for a silent one, for the report


def start(cluster: Cluster | None = None, processes: int = 1) -> None:
    """Sets up JAX; to be called before any computation. `cluster`: of this process; `processes` share the cores.

    Raises: typer.BadParameter for a cluster that cannot be joined.
    """
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", max(1, min(cores() // processes, MAX_DEVICES)))
    keep_programs()
    if cluster is not None:
        _join(cluster)


def _join(cluster: Cluster) -> None:
    """Connects to the other processes. Afterwards a failing process ends immediately and notifies the others."""
    jax.config.update("jax_enable_preemption_service", False)  # JAX would interpret SIGTERM as a notice of preemption
    waiting = Timer(MEETING, _not_met, [cluster])
    waiting.daemon = True
    waiting.start()
    try:
        jax.distributed.initialize(
            None if cluster.coordinator == AUTOMATIC else cluster.coordinator,
            cluster.processes,
            cluster.process,
            initialization_timeout=2
            * MEETING,  # longer than our own time limit, because JAX ends the process without our message
            heartbeat_timeout_seconds=LOST,
            shutdown_timeout_seconds=WRITING,
        )
    except ValueError as error:
        cure = (
            "give HOST:PORT with --processes and --process" if cluster.coordinator == AUTOMATIC else "check the address"
        )
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
    atexit.register(_end_at_once, restored)  # runs before the function of JAX, which waits for the other processes


def _require_count(cluster: Cluster) -> None:
    """Raises typer.BadParameter if process 0 has another number of processes than this one."""
    if cluster.processes is not None and jax.process_count() != cluster.processes:
        raise typer.BadParameter(
            f"--processes {cluster.processes} here, but {jax.process_count()} for process 0; give the same number"
        )


def _not_met(cluster: Cluster) -> None:
    address, count, number = cluster
    who = "process" if number is None else f"process {number} of {count}"
    typer.echo(
        f"jaxbundle: {who} could not connect to the others at {address} in {MEETING} s; start process 0 there and one"
        " process of each number with the same --coordinator and --processes, and open the port in the firewall",
        err=True,
    )
    os._exit(2)


def finished() -> None:
    """Marks the end of the work: this process may end when the others end."""
    atexit.unregister(_end_at_once)


def _end_at_once(before: Callable[[], None]) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    before()
    os._exit(Code.BAD_INPUT)
