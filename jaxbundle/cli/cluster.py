"""The options of a cluster: how the processes on several machines connect."""

from typing import NamedTuple

import typer

AUTOMATIC = "auto"


class Cluster(NamedTuple):
    """Address of the first process, number of processes and of this one; "auto": from the environment of the job."""

    coordinator: str
    processes: int | None
    process: int | None


def cluster_of(coordinator: str | None, processes: int | None, process: int | None) -> Cluster | None:
    """The cluster of the options; None for a single process.

    Raises: typer.BadParameter for incompatible options.
    """
    if coordinator is None:
        if processes is not None or process is not None:
            raise typer.BadParameter("--processes and --process require --coordinator HOST:PORT")
        return None
    if coordinator == AUTOMATIC:
        if processes is not None or process is not None:
            raise typer.BadParameter(f"--coordinator {AUTOMATIC} determines --processes and --process; drop them")
        return Cluster(coordinator, None, None)
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdecimal():
        raise typer.BadParameter(
            f"--coordinator {coordinator} is neither HOST:PORT, such as 10.0.0.1:4000, nor {AUTOMATIC}"
        )
    if processes is None or process is None:
        raise typer.BadParameter("--coordinator HOST:PORT needs --processes N and --process I, from 0 to N - 1")
    if not 0 <= process < processes:
        raise typer.BadParameter(f"--process {process} is not from 0 to {processes - 1}")
    return Cluster(coordinator, processes, process)
