"""Cost of a block of any size, from constants measured on this machine: python tests/benchmarks/cost_model.py

Measures two generated blocks on one core: time a ray of an iteration (linearise and eliminate, substitute), time a
floating point operation of the panel Cholesky, time a ray of a product of conjugate gradients, bytes a ray. Counts the
tiles and products of the factor exactly for square aerial blocks of 80/60 % overlap and 6 unknowns an image. What is
printed for machines follows from these by the formulas of `iteration` and `memory`; nothing of it is measured.
"""

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # before JAX counts cores

import equinox as eqx  # noqa: E402, I001
import jax  # noqa: E402
import numpy as np  # noqa: E402
from blocks import SIZES, write_block  # noqa: E402
from parts_worker import arranged, parts_of  # noqa: E402

from jaxbundle.io import read_bal  # noqa: E402
from jaxbundle.normals.plan.elimination_order import elimination_order, ranked_pairs  # noqa: E402
from jaxbundle.normals.panel_cholesky import PanelCholesky  # noqa: E402
from jaxbundle.normals.normal_products import reduced_product  # noqa: E402
from jaxbundle.normals.plan.reduced_plan import panel_width  # noqa: E402
from jaxbundle.normals.problem import Problem  # noqa: E402
from jaxbundle.normals.step import trial_step  # noqa: E402
from jaxbundle.normals.chunks import BY_DEVICE, EVERYWHERE, over_devices  # noqa: E402
from jaxbundle.normals.plan.panel_lists import fill  # noqa: E402

REPETITIONS, D, FLOAT = 5, 6, 8
CORES, NETWORK = 8, 1.25e9  # assumed: of a machine; bytes a second between two machines (10 Gbit/s)
RAYS_AN_IMAGE = 10_000
HOST_BYTES = 200  # a ray, reading and laying out: growth of peak memory from 320 to 1200 images (265), less ray_bytes


class Constants(NamedTuple):
    """Seconds a ray, a flop, a ray and product of conjugate gradients; their number a step; bytes a ray on devices."""

    ray: float
    flop: float
    product: float
    products: float
    ray_bytes: float


class Factor(NamedTuple):
    """Blocks of image pairs; tiles that one device holds, and those of the separator, summed over all devices; flops of
    the longest way through the columns; rows of a tile."""

    pairs: int
    tiles: int
    summed: int
    flops: float
    b: int


def seconds(function: Callable[[], Any], repetitions: int = REPETITIONS) -> float:
    """Median, warm."""
    jax.block_until_ready(function())
    times = []
    for _ in range(repetitions):
        begin = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def flops_of(below: np.ndarray, b: int) -> float:
    """Of columns with so many tiles below the diagonal: their factors, divisions, products of tiles."""
    return float(np.sum(b**3 + 2 * b**3 * below + b**3 * below * (below + 1)))


def solver_flops(p: Problem) -> float:
    """Of one factorisation as it is done."""
    cholesky = p.reduced.images
    assert isinstance(cholesky, PanelCholesky)
    columns = cholesky.lists.separator
    count, b = int(columns.count[0]), columns.block.shape[2] * p.layout.image
    return flops_of(np.diff(np.asarray(columns.first_below[0]))[:count], b)


def measured(path: Path) -> Constants:
    """Constants from one block."""
    block = read_bal(path)
    rays = len(block.structure.ray_image)
    unknowns, p, damping = arranged(block, True)
    parts = parts_of(unknowns, p, damping)
    time_of = {name: seconds(part) for name, part in parts.items()}
    linear, _, stored = parts["linearise, eliminate"]()
    product = eqx.filter_jit(
        lambda linear, stored: over_devices(
            lambda linear, stored: linear.total(reduced_product(linear, linear.values, stored)),
            linear,
            EVERYWHERE,
            (stored,),
            (BY_DEVICE,),
        )
    )
    per_product = seconds(lambda: product(linear, stored))
    step: Any = eqx.filter_jit(trial_step)
    memory = step.lower(unknowns, p, damping).compile().compiled.memory_analysis()
    reduced = FLOAT * p.layout.image**2 * p.layout.pairs
    on_device = memory.argument_size_in_bytes + memory.output_size_in_bytes
    of_rays = time_of["linearise, eliminate"] + time_of["substitute"]
    by_pcg = seconds_by_conjugate_gradients(path)
    print(
        f"{path.stem} images, {rays} rays, d = {p.layout.image}: step {time_of['step']:.3f} s"
        f" (rays {of_rays:.3f}, reduced {time_of['reduced solve']:.3f}), by conjugate gradients {by_pcg:.2f} s,"
        f" one product {per_product:.4f} s; arrays {on_device / 1e6:.0f} MB, temporary"
        f" {memory.temp_size_in_bytes / 1e6:.0f} MB, of which the blocks of pairs {reduced / 1e6:.1f} MB a copy"
    )
    return Constants(
        of_rays / rays,
        time_of["reduced solve"] / solver_flops(p),
        per_product / rays,
        max(by_pcg - of_rays, 0.0) / per_product,
        (on_device + 12 * FLOAT * unknowns.tiles.shape[1] * unknowns.tiles.shape[2]) / rays,
    )


def seconds_by_conjugate_gradients(path: Path) -> float:
    """Of a step."""
    unknowns, p, damping = arranged(read_bal(path), False, "pcg")
    step = eqx.filter_jit(trial_step)
    return seconds(lambda: step(unknowns, p, damping), 1)


def aerial_graph(images: int) -> tuple[int, np.ndarray]:
    """Images of a square block, 80/60 % overlap, and the pairs that overlap."""
    strips = max(2, round((images / 2) ** 0.5))
    along = -(-images // strips)
    row, column = np.divmod(np.arange(strips * along), along)
    pairs = []
    for rows in range(3):
        for columns in range(-4 if rows else 0, 5):
            here = (row + rows < strips) & (column + columns >= 0) & (column + columns < along)
            i = np.nonzero(here)[0]
            pairs.append(np.stack([i + rows * along + columns, i], 1))
    return strips * along, np.concatenate(pairs)


def factor_of(images: int, devices: int) -> Factor:
    """The factor of an aerial block, counted."""
    images, pairs = aerial_graph(images)
    q = panel_width(images, D)
    order = elimination_order(pairs, images, q, devices)
    ranked = ranked_pairs(pairs, order.rank)
    starts = np.cumsum([0, *(-(-size // q) for size in order.sizes)])
    first = np.cumsum([0, *order.sizes])
    part = np.searchsorted(first[1:], np.arange(images), side="right")
    panel = starts[part] + (np.arange(images) - first[part]) // q
    below = fill(panel[ranked], int(starts[-1])).sum(0) - 1
    ends, separator = [below[a:b] for a, b in zip(starts[:2], starts[1:3], strict=True)], below[starts[2] :]
    b = q * D
    flops = max(flops_of(end, b) for end in ends) + flops_of(separator, b)
    summed = int((separator + 1).sum())
    split = order.sizes[0] > 0
    tiles = summed + max(int((end + 1).sum()) for end in ends)
    return Factor(len(ranked), tiles, summed if split else 0, flops, b)


def iteration(c: Constants, f: Factor, images: int, rays: int, machines: int, solver: str) -> tuple[float, ...]:
    """Seconds of an iteration: rays, reduced equations, exchange between machines."""
    share = rays / (CORES * machines)
    if solver == "panels":
        sent = FLOAT * (D * D * f.pairs + f.summed * f.b**2)
        return c.ray * share, c.flop * f.flops, 2 * (machines - 1) / machines * sent / NETWORK
    sent = FLOAT * 15 * images * c.products
    return c.ray * share + c.products * c.product * share, 0.0, 2 * (machines - 1) / machines * sent / NETWORK


def memory(c: Constants, f: Factor, rays: int, machines: int, solver: str) -> tuple[float, float]:
    """Bytes on a machine: its devices' arrays, and the whole block, which every process reads and lays out."""
    reduced = CORES * FLOAT * (2 * D * D * f.pairs + f.tiles * f.b**2) if solver == "panels" else 0
    return c.ray_bytes * rays / machines + reduced, HOST_BYTES * rays


def main() -> None:
    """Prints constants and table."""
    with tempfile.TemporaryDirectory() as folder:
        found = []
        for name in sys.argv[1:] or ("110", "320"):
            path = Path(folder) / name
            write_block(path, *SIZES[name])
            found.append(measured(path))
    c = found[-1]
    for one in found:
        print(
            f"ray {one.ray * 1e9:.0f} ns, {1e-9 / one.flop:.1f} GF/s, product {one.product * 1e9:.0f} ns a ray,"
            f" {one.products:.0f} products a step, {one.ray_bytes:.0f} bytes a ray"
        )
    print(f"\nMachines of {CORES} cores, {NETWORK / 1e9:.2f} GB/s between them, {RAYS_AN_IMAGE} rays an image; GB, s")
    print("images  solver  machines  factor  flops    rays  reduced  exchange  iteration  devices' GB  host GB")
    for images in (100, 1000, 10_000, 100_000):
        f, rays = factor_of(images, CORES), RAYS_AN_IMAGE * images
        for solver in ("panels", "pcg"):
            for machines in (1, 8, 64):
                t = iteration(c, f, images, rays, machines, solver)
                m = memory(c, f, rays, machines, solver)
                size = f"{FLOAT * f.tiles * f.b**2 / 1e9:6.2f}  {f.flops:.0e}" if solver == "panels" else " " * 13
                print(
                    f"{images:6}  {solver:6}  {machines:8}  {size}  {t[0]:6.1f}  {t[1]:7.2f}  {t[2]:8.2f}"
                    f"  {sum(t):9.1f}  {m[0] / 1e9:11.1f}  {m[1] / 1e9:7.1f}"
                )


if __name__ == "__main__":
    main()
