"""Times many adjustments of one block at once: python tests/benchmarks/batches.py [--draws N] [--images N]

The observations of a simulated block are drawn again and again; all draws are adjusted by one vmapped and jitted call,
on one device and dealt to one device a core, against a Python loop over `jb.adjust` in the same process.
"""

import argparse
import os
import sys
import time

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))

import equinox as eqx  # noqa: E402
import numpy as np  # noqa: E402
from jax.sharding import AxisType, NamedSharding, PartitionSpec  # noqa: E402
from table import print_machine  # noqa: E402

import jaxbundle as jb  # noqa: E402


def main() -> int:
    """Command line; exit code 1 where the results differ."""
    parser = argparse.ArgumentParser(description="Times many adjustments of one block at once.")
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--strips", type=int, default=4)
    parser.add_argument("--images", type=int, default=10, help="of a strip")
    parser.add_argument("--points", type=int, default=30, help="of an image")
    parser.add_argument("--looped", type=int, default=50, help="draws adjusted one by one")
    options = parser.parse_args()
    simulation = jb.simulate(options.strips, options.images, points_per_image=options.points)
    block, truth = jb.blocks.with_datum(simulation.block), simulation.truth
    rng = np.random.default_rng(0)
    exact, sigmas = np.asarray(truth.rays.coordinates), np.asarray(truth.rays.sigmas)
    draws = exact + sigmas * rng.standard_normal((options.draws, *exact.shape))

    def one(coordinates: jax.Array) -> jax.Array:
        drawn = eqx.tree_at(lambda b: b.rays.coordinates, block, coordinates)
        return jb.adjust(drawn, precision=False).sigma0

    dealt = PartitionSpec("draw")
    mesh = jax.make_mesh((jax.local_device_count(),), ("draw",), axis_types=(AxisType.Auto,))
    on_devices = jax.shard_map(jax.vmap(one), mesh=mesh, in_specs=dealt, out_specs=dealt, check_vma=False)
    times = {}
    for name, function, given in (
        ("one call", jax.vmap(one), draws),
        (f"one call, {mesh.size} devices", on_devices, jax.device_put(draws, NamedSharding(mesh, dealt))),
    ):
        program = jax.jit(function)
        start = time.perf_counter()
        together = np.asarray(program(given))
        first = time.perf_counter() - start
        start = time.perf_counter()
        together = np.asarray(program(given))
        times[name] = (time.perf_counter() - start) / options.draws, first, together
    one(draws[0])
    start = time.perf_counter()
    alone = np.array([float(one(d)) for d in draws[: options.looped]])
    looped = (time.perf_counter() - start) / len(alone)
    print_machine(None)
    structure = block.structure
    print(f"\n{len(structure.image_names)} images, {len(structure.ray_image)} rays; {options.draws} draws")
    print(f"  {'one by one':22} {1e3 * looped:8.2f} ms each")
    worst = 0.0
    for name, (seconds, first, together) in times.items():
        difference = np.abs(together[: len(alone)] / alone - 1).max()
        print(
            f"  {name:22} {1e3 * seconds:8.2f} ms each, ratio {looped / seconds:.2f}; the first call took {first:.1f} s"
        )
        print(f"  {'':22} largest relative difference of sigma0 {difference:.1e}")
        worst = max(worst, difference)
    return 0 if worst < 1e-8 else 1


if __name__ == "__main__":
    sys.exit(main())
