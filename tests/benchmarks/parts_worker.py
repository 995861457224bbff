"""Times the parts of an iteration and of the standard deviations of a BAL file, each compiled by itself and warm.

Prints `part NAME SECONDS`: the whole trial step; linearise and eliminate, reduced solve, substitute, which together are
the step (checked); the cofactors of all images and points. What lies between two parts is stored for the next, so their
sum is not the step's time to the last percent. Conjugate gradients cannot be cut out: no parts then.
"""

import statistics
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxbundle.cli import runtime

runtime.start()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jaxtyping import Array  # noqa: E402

from jaxbundle.block.block import Block  # noqa: E402
from jaxbundle.block.datum import with_datum  # noqa: E402
from jaxbundle.block.unknowns import Unknowns, corrected, unknowns_of  # noqa: E402
from jaxbundle.io import read_bal  # noqa: E402
from jaxbundle.normals.back_substitution import substitute  # noqa: E402
from jaxbundle.normals.chunks import BY_DEVICE, EVERYWHERE, OF_TILES, image_table, over_devices  # noqa: E402
from jaxbundle.normals.cofactors import cofactors  # noqa: E402
from jaxbundle.normals.eliminate import eliminate  # noqa: E402
from jaxbundle.normals.from_block import problem, to_elimination_order  # noqa: E402
from jaxbundle.normals.plan.elimination_plan import plan_elimination  # noqa: E402
from jaxbundle.normals.plan.reduced_plan import Method  # noqa: E402
from jaxbundle.normals.problem import Linearised, OrderedUnknowns, Problem, ReducedVector  # noqa: E402
from jaxbundle.normals.reduced_system import ReducedSystem, factorise, step  # noqa: E402
from jaxbundle.normals.reduced_vector import correction_of, values_along  # noqa: E402
from jaxbundle.normals.step import linearise, placed, reduced_system, trial_step  # noqa: E402
from jaxbundle.solve.adjust import RAYS_FOR_DEVICES  # noqa: E402
from jaxbundle.solve.damping import Marquardt  # noqa: E402

REPETITIONS, LONG = 9, 20.0  # turns, and seconds after which no further one begins


def arranged(block: Block, direct: bool, solver: Method = "auto") -> tuple[OrderedUnknowns, Problem, Array]:
    """Start values, problem and first damping, as `adjust` lays them on the devices."""
    block = with_datum(block)
    centred = block.moved(-jnp.asarray(np.asarray(block.exterior.projection_centre).mean(0)))
    devices = jax.local_device_count() if len(block.structure.ray_image) >= RAYS_FOR_DEVICES else 1
    centres = np.asarray(block.exterior.projection_centre)
    plan = plan_elimination(block.structure, block.groups, centres, devices, solver, direct=direct)
    return placed(
        to_elimination_order(plan, unknowns_of(centred)), problem(plan, centred), Marquardt().initial_state().factor
    )


def eliminated(unknowns: OrderedUnknowns, p: Problem, damping: Array) -> tuple[Linearised, ReducedSystem, Array]:
    """The linearised equations, the reduced equations, the equations of the points."""

    def kernel(linear: Linearised, damping: Array) -> tuple[ReducedSystem, Array]:
        rays, stored = eliminate(linear, damping)
        return reduced_system(linear.total(rays), linear).system, stored

    linear = linearise(unknowns, p)
    return linear, *over_devices(kernel, linear, (EVERYWHERE, BY_DEVICE), (damping,))


def solved(linear: Linearised, system: ReducedSystem, damping: Array) -> ReducedVector:
    """The step of images and border."""

    def kernel(linear: Linearised, system: ReducedSystem, damping: Array) -> ReducedVector:
        solver = linear.problem.reduced
        return ReducedVector(*step(solver, factorise(solver, system, damping)))

    return over_devices(kernel, linear, EVERYWHERE, (system, damping))


def substituted(
    linear: Linearised, damping: Array, stored: Array, x: ReducedVector
) -> tuple[Unknowns, Array, tuple[Array, ...]]:
    """The unknowns after the step, and the sums over the rays."""

    def kernel(linear: Linearised, damping: Array, stored: Array, x: ReducedVector) -> tuple:
        o, unknowns = linear.problem.observations, linear.unknowns.images
        after = corrected(unknowns, correction_of(x, linear.problem, linear.unknowns), o.in_angles, o.system)
        part = substitute(linear, values_along(x, linear), image_table(after, None, o), stored, damping)
        return after, part.points, linear.total(tuple(part[1:]))

    parts = EVERYWHERE, BY_DEVICE, ReducedVector(EVERYWHERE, EVERYWHERE)
    return over_devices(kernel, linear, (EVERYWHERE, OF_TILES, EVERYWHERE), (damping, stored, x), parts)


class Part(NamedTuple):
    """A compiled function and its arguments."""

    compiled: Callable[..., Any]
    args: tuple[Any, ...]

    def __call__(self) -> Any:
        return jax.block_until_ready(self.compiled(*self.args))


def parts_of(unknowns: OrderedUnknowns, p: Problem, damping: Array) -> dict[str, Part]:
    """The step and its parts, compiled, each with what the part before it gave.

    Raises: AssertionError where the parts do not lead where the step does.
    """
    parts = {"step": Part(eqx.filter_jit(trial_step), (unknowns, p, damping))}
    after = parts["step"]().unknowns
    if p.layout.implicit:
        return parts
    parts["linearise, eliminate"] = Part(eqx.filter_jit(eliminated), (unknowns, p, damping))
    linear, system, stored = parts["linearise, eliminate"]()
    parts["reduced solve"] = Part(eqx.filter_jit(solved), (linear, system, damping))
    x = parts["reduced solve"]()
    parts["substitute"] = Part(eqx.filter_jit(substituted), (linear, damping, stored, x))
    images, tiles, _ = parts["substitute"]()
    for whole, part in ((after.tiles, tiles), (after.images.centre, images.centre)):
        np.testing.assert_allclose(part, whole, rtol=1e-9, atol=1e-9 * float(jnp.abs(whole).max()))
    return parts


def main() -> None:
    """Command line: FILE. The parts take turns: other work on the machine slows all of them."""
    block = read_bal(sys.argv[1])
    unknowns, p, damping = arranged(block, direct=False)
    parts = parts_of(unknowns, p, damping)
    if p.layout.implicit:
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
