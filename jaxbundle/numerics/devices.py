"""The devices that share the work: those of this process, or of all processes of a cluster (`jax.distributed`).

Processes run the same calls on the same block. Each knows the whole plan, puts its own parts on its own devices, and
gets the whole result (`host.on_host`).
"""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import multihost_utils
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec, Sharding
from jaxtyping import Array

from jaxbundle.numerics.host import on_device, on_host

AXIS = "device"


def device_mesh(devices: int) -> Mesh:
    """The first `devices` devices, in the order of the processes."""
    return Mesh(np.array(jax.devices()[:devices]), (AXIS,), axis_types=(AxisType.Auto,))


def put(value: Any, sharding: Sharding) -> Array:
    """A number, an array or a tracer where `sharding` says; a process touches its own part only."""
    elsewhere = isinstance(value, jax.Array) and not isinstance(value, Tracer) and not value.is_fully_addressable
    if sharding.is_fully_addressable or elsewhere or isinstance(value, Tracer):
        return jax.device_put(value, sharding)
    # not by device_put: it compares the whole array over all processes
    host = np.asarray(value)
    return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])


def dealt(value: Any, devices: int, axis: int = 0) -> Array:
    """An array parted along an axis over the devices; a tracer stays what it is."""
    if devices == 1 or isinstance(value, Tracer):
        return on_device(value)
    return put(value, NamedSharding(device_mesh(devices), PartitionSpec(*[None] * axis, AXIS)))


def meet() -> None:
    """Waits for all processes.

    Devices that exchange anything for the first time must do so within 30 s of each other (gloo), which processes that
    read and compile at their own pace would miss.
    """
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices("jaxbundle")


def is_first_process() -> bool:
    """Whether this is the process that writes and prints; one alone is."""
    return jax.process_index() == 0


def from_first_process(tree: Any) -> Any:
    """The arrays of the first process in all processes; `tree` gives their form."""
    if jax.process_count() == 1:
        return tree
    return jax.tree.map(lambda x: on_device(on_host(x)), multihost_utils.broadcast_one_to_all(tree))


def equal_in_all_processes(mark: bytes) -> bool:
    """Whether all processes give the same bytes, of which there must be equally many."""
    if jax.process_count() == 1:
        return True
    marks = multihost_utils.process_allgather(np.frombuffer(mark, np.uint8))
    return bool((np.asarray(marks) == np.asarray(marks)[0]).all())
