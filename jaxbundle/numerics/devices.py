"""Distribution over devices of this process, or of all processes of a cluster (`jax.distributed`).

Processes run the same calls on the same block. Each process has the whole plan, puts its parts on its devices, and
gets the whole result (`host.on_host`).
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Any, TypeVar

import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import multihost_utils
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec, Sharding
from jaxtyping import Array

from jaxbundle.numerics.host import on_device, on_host

AXIS = "device"
Item = TypeVar("Item")
Result = TypeVar("Result")


def device_mesh(devices: int) -> Mesh:
    """The first `devices` devices, in the order of the processes."""
    return Mesh(np.array(jax.devices()[:devices]), (AXIS,), axis_types=(AxisType.Auto,))


def put(value: Any, sharding: Sharding) -> Array:
    """Puts a number, an array or a tracer on the devices of `sharding`; a process handles only its part."""
    elsewhere = isinstance(value, jax.Array) and not isinstance(value, Tracer) and not value.is_fully_addressable
    if sharding.is_fully_addressable or elsewhere or isinstance(value, Tracer):
        return jax.device_put(value, sharding)
    # not by device_put, which compares the whole array over all processes
    host = np.asarray(value)
    return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])


def dealt(value: Any, devices: int, axis: int = 0) -> Array:
    """Distributes an array along an axis over the devices; a tracer is unchanged."""
    if devices == 1 or isinstance(value, Tracer):
        return on_device(value)
    return put(value, NamedSharding(device_mesh(devices), PartitionSpec(*[None] * axis, AXIS)))


def copied(tree: Any, devices: int) -> Any:
    """Traced arrays, whole on each device.

    For computations that are not written for several devices: where XLA divided one of them, its transposed derivatives
    were not finite (jaxlib 0.10.2; the reason is not known).
    """
    if devices == 1:
        return tree
    whole = NamedSharding(device_mesh(devices), PartitionSpec())
    return jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, whole), tree)


def meet() -> None:
    """Waits for all processes.

    The first communication between devices must start within 30 s in all processes (gloo); reading and compiling can
    take longer.
    """
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices("jaxbundle")


def is_first_process() -> bool:
    """Whether this process writes and prints; true for a single process."""
    return jax.process_index() == 0


def from_first_process(tree: Any) -> Any:
    """Sends the arrays of the first process to all processes; `tree` has their shapes."""
    if jax.process_count() == 1:
        return tree
    return jax.tree.map(lambda x: on_device(on_host(x)), multihost_utils.broadcast_one_to_all(tree))


def equal_in_all_processes(mark: bytes) -> bool:
    """Whether all processes have the same bytes, whose number must be equal."""
    if jax.process_count() == 1:
        return True
    marks = multihost_utils.process_allgather(np.frombuffer(mark, np.uint8))
    return bool((np.asarray(marks) == np.asarray(marks)[0]).all())


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_cores(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Results of a function for each item, in their order, computed in threads on all cores.

    The first item is computed alone, since it compiles the programs of all. After an error, or if the caller stops,
    items that are not begun are left out.
    """
    yield from map(function, items[:1])
    jobs = [(copy_context(), item) for item in items[1:]]  # threads do not have the caller's numpy.errstate
    with ThreadPoolExecutor(cores()) as pool:
        try:
            yield from pool.map(lambda job: job[0].run(function, job[1]), jobs)
        finally:
            pool.shutdown(cancel_futures=True)
