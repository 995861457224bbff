"""The options of a cluster: how the processes on its machines find each other."""

from typing import NamedTuple

import typer

AUTOMATIC = "auto"


class Cluster(NamedTuple):
    """Address of the first process, number of processes and number of this one; "auto": the job's environment says."""

    coordinator: str
    processes: int | None
    process: int | None


def cluster_of(coordinator: str | None, processes: int | None, process: int | None) -> Cluster | None:
    """The cluster of these options; None for a process alone.

    Raises: typer.BadParameter for options that do not belong together.
    """
    if coordinator is None:
        if processes is not None or process is not None:
            raise typer.BadParameter("--processes and --process belong to --coordinator HOST:PORT")
        return None
    if coordinator == AUTOMATIC:
        if processes is not None or process is not None:
            raise typer.BadParameter(f"--coordinator {AUTOMATIC} finds --processes and --process by itself; drop them")
        return Cluster(coordinator, None, None)
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdecimal():
        raise typer.BadParameter(f"--coordinator {coordinator} is not HOST:PORT, as 10.0.0.1:4000, nor {AUTOMATIC}")
    if processes is None or process is None:
        raise typer.BadParameter("--coordinator HOST:PORT needs --processes N and --process I, from 0 to N - 1")
    if not 0 <= process < processes:
        raise typer.BadParameter(f"--process {process} is not from 0 to {processes - 1}, as --processes says")
    return Cluster(coordinator, processes, process)
