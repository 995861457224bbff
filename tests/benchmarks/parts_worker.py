"""Times the parts of an iteration and of the standard deviations of a BAL file, each compiled by itself and warm.

Prints `part NAME SECONDS`: the whole trial step; linearise and eliminate, reduced solve, substitute, which together are
the step (checked); the cofactors of all images and points. What lies between two parts is stored for the next, so their
sum is not the step's time to the last percent. Conjugate gradients cannot be cut out: no parts then.
"""

import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from jaxbundle.cli import runtime

runtime.start()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jax import lax  # noqa: E402
from jax.sharding import PartitionSpec  # noqa: E402
from jaxtyping import Array  # noqa: E402

from jaxbundle.block.block import Block  # noqa: E402
from jaxbundle.block.datum import with_datum  # noqa: E402
from jaxbundle.block.unknowns import Unknowns, corrected, unknowns_of  # noqa: E402
from jaxbundle.io import read_bal  # noqa: E402
from jaxbundle.normals.arrange import Arranged, Problem, arrange, arranged_unknowns, problem  # noqa: E402
from jaxbundle.normals.cofactors import cofactors  # noqa: E402
from jaxbundle.normals.eliminate import eliminate  # noqa: E402
from jaxbundle.normals.kept_vector import correction_of, direction_of  # noqa: E402
from jaxbundle.normals.partition import local_tiles  # noqa: E402
from jaxbundle.normals.reduced_plan import Method  # noqa: E402
from jaxbundle.normals.reduced_system import ReducedSystem, factorise, step  # noqa: E402
from jaxbundle.normals.step import (  # noqa: E402
    Linearised,
    linearise,
    partition,
    placed,
    reduced_system,
    trial_step,
)
from jaxbundle.normals.substitute import image_values, substitute  # noqa: E402
from jaxbundle.numerics.devices import AXIS, device_mesh  # noqa: E402
from jaxbundle.solve.adjust import RAYS_FOR_DEVICES  # noqa: E402
from jaxbundle.solve.damping import Marquardt  # noqa: E402

EVERYWHERE: Any = PartitionSpec()
REPETITIONS, LONG = 9, 20.0  # turns, and seconds after which no further one begins


def arranged(block: Block, direct: bool, solver: Method = "auto") -> tuple[Arranged, Problem, Array]:
    """Start values, problem and first damping, as `adjust` lays them on the devices."""
    block = with_datum(block)
    centred = block.moved(-jnp.asarray(np.asarray(block.exterior.projection_centre).mean(0)))
    devices = jax.local_device_count() if len(block.structure.ray_image) >= RAYS_FOR_DEVICES else 1
    centres = np.asarray(block.exterior.projection_centre)
    plan = arrange(block.structure, block.groups, centres, devices, solver, direct)
    return placed(
        arranged_unknowns(plan, unknowns_of(centred)), problem(plan, centred), Marquardt().initial_state().factor
    )


def on_devices(function: Callable[..., Any], p: Problem, in_specs: tuple, out_specs: Any) -> Callable[..., Any]:
    """The function on every device's own tiles."""
    if p.devices == 1:
        return partial(function, axis=None)
    mesh = device_mesh(p.devices)
    return jax.shard_map(
        partial(function, axis=AXIS), mesh=mesh, in_specs=in_specs, out_specs=out_specs, check_vma=False
    )


def eliminated(unknowns: Arranged, p: Problem, damping: Array) -> tuple[Linearised, ReducedSystem, Array]:
    """Tables of the images, reduced equations, factors of the points."""

    def one(unknowns: Arranged, linear: Linearised, damping: Array, p: Problem, free: Array, axis: str | None):
        tiles, o = local_tiles(p.tiles), p.observations
        rays, factors = eliminate(
            o, linear.table, unknowns.tiles, linear.prior, free, damping, tiles, p.shape, p.diagonal_pair
        )
        return reduced_system(lax.psum(rays, axis) if axis else rays, linear.kept, p).system, factors

    linear = linearise(unknowns, p)
    u, n, q = partition(unknowns, linear, p)
    specs = (u, n, EVERYWHERE, q, PartitionSpec(None, AXIS))
    whole = on_devices(one, p, specs, (EVERYWHERE, PartitionSpec(AXIS)))
    return linear, *whole(unknowns, linear, damping, p, p.free_tiles)


def solved(p: Problem, system: ReducedSystem, damping: Array) -> tuple[Array, Array]:
    """The step of images and border."""

    def one(reduced: Any, system: ReducedSystem, damping: Array, axis: str | None) -> tuple[Array, Array]:
        return step(reduced, factorise(reduced, system, damping))

    return on_devices(one, p, (EVERYWHERE,) * 3, EVERYWHERE)(p.reduced, system, damping)


def substituted(
    unknowns: Arranged, linear: Linearised, damping: Array, p: Problem, factors: Array, images: Array, border: Array
) -> tuple[Unknowns, Array, tuple[Array, ...]]:
    """The unknowns after the step, and the sums over the rays."""

    def one(unknowns, linear, damping, p, factors, images, border, axis):
        o, correction = p.observations, correction_of(images, border, p, unknowns)
        moved = corrected(unknowns.images, correction, o.in_angles, o.system)
        before, along, after = (
            image_values(u, o) for u in (unknowns.images, direction_of(correction, linear.turns), moved)
        )
        part = substitute(o, before, along, after, unknowns.tiles, factors, damping, local_tiles(p.tiles))
        return moved, part.points, tuple(lax.psum(part[1:], axis) if axis else part[1:])

    u, n, q = partition(unknowns, linear, p)
    specs = (u, n, EVERYWHERE, q, PartitionSpec(AXIS), EVERYWHERE, EVERYWHERE)
    whole = on_devices(one, p, specs, (EVERYWHERE, PartitionSpec(None, AXIS), EVERYWHERE))
    return whole(unknowns, linear, damping, p, factors, images, border)


class Part(NamedTuple):
    """A compiled function and its arguments."""

    compiled: Callable[..., Any]
    args: tuple[Any, ...]

    def __call__(self) -> Any:
        return jax.block_until_ready(self.compiled(*self.args))


def parts_of(unknowns: Arranged, p: Problem, damping: Array) -> dict[str, Part]:
    """The step and its parts, compiled, each with what the part before it gave.

    Raises: AssertionError where the parts do not lead where the step does.
    """
    parts = {"step": Part(eqx.filter_jit(trial_step), (unknowns, p, damping))}
    after = parts["step"]().unknowns
    if p.shape.implicit:
        return parts
    parts["linearise, eliminate"] = Part(eqx.filter_jit(eliminated), (unknowns, p, damping))
    linear, system, factors = parts["linearise, eliminate"]()
    parts["reduced solve"] = Part(eqx.filter_jit(solved), (p, system, damping))
    kept = parts["reduced solve"]()
    parts["substitute"] = Part(eqx.filter_jit(substituted), (unknowns, linear, damping, p, factors, *kept))
    images, tiles, _ = parts["substitute"]()
    for whole, part in ((after.tiles, tiles), (after.images.centre, images.centre)):
        np.testing.assert_allclose(part, whole, rtol=1e-9, atol=1e-9 * float(jnp.abs(whole).max()))
    return parts


def main() -> None:
    """Command line: FILE. The parts take turns: other work on the machine slows all of them."""
    block = read_bal(sys.argv[1])
    unknowns, p, damping = arranged(block, direct=False)
    parts = parts_of(unknowns, p, damping)
    if p.shape.implicit:
        unknowns, p, _ = arranged(block, direct=True)
    parts["cofactors"] = Part(eqx.filter_jit(cofactors), (unknowns, p))
    parts["cofactors"]()
    seconds: dict[str, list[float]] = {name: [] for name in parts}
    start = time.perf_counter()
    for turn in range(REPETITIONS):
        if turn and time.perf_counter() - start > LONG:
            break
        for name, part in parts.items():
            begin = time.perf_counter()
            part()
            seconds[name].append(time.perf_counter() - begin)
    for name, times in seconds.items():
        print(f"part {name} {statistics.median(times)}")


if __name__ == "__main__":
    main()
