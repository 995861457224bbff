"""H^-1 b: v^T P v / 2 with its second derivatives in full.

    H = N + sum of w v d2v        N = A^T P A, as the normal equations have it

H has the blocks of N and differs from it by the size of the residuals: conjugate gradients preconditioned with the
factorised N gain several digits an iteration. One product runs through all tiles once: a forward derivative of the
gradient of every chunk, nothing is stored.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Observations, group_residuals, weighted
from jaxbundle.block.unknowns import corrected
from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.cells import Tiles, at_slots, chunk_of, points_at_cells, sum_by_tile
from jaxbundle.normals.implicit import KeptVector
from jaxbundle.normals.rows import image_equation
from jaxbundle.normals.solution import factorised_normals
from jaxbundle.normals.step import (
    Linearised,
    correction_of,
    kept_free,
    linearise,
    local_tiles,
    other_residuals,
    partition,
)
from jaxbundle.normals.substitute import image_values, split_values
from jaxbundle.normals.vector import NormalVector
from jaxbundle.numerics.conjugate_gradients import conjugate_gradients
from jaxbundle.numerics.devices import AXIS, device_mesh

TOLERANCE = 1e-13  # of the first residual: a derivative is to have the digits of the unknowns
MOST_ITERATIONS = 100


def solve_hessian(unknowns: Arranged, p: Problem, right: NormalVector) -> NormalVector:
    """H^-1 b at a minimum; not finite where N is singular, or H not positive definite."""
    linear, free, groups = linearise(unknowns, p), p.free_tiles, _point_hessian(unknowns, p)
    if p.devices == 1:
        return _on_device(unknowns, unknowns.tiles, linear, groups, p, free, right, None)
    everywhere: Any = PartitionSpec()
    of_tiles: Any = PartitionSpec(None, AXIS)
    of_blocks = None if groups is None else PartitionSpec(None, None, AXIS)
    vector = NormalVector(everywhere, everywhere, of_tiles)
    unknown_parts, linear_parts, problem_parts = partition(unknowns, linear, p)
    return jax.shard_map(
        partial(_on_device, axis=AXIS),
        mesh=device_mesh(p.devices),
        in_specs=(unknown_parts, everywhere, linear_parts, of_blocks, problem_parts, of_tiles, vector),
        out_specs=vector,
        check_vma=False,
    )(unknowns, unknowns.tiles, linear, groups, p, free, right)


def _on_device(
    unknowns: Arranged,
    all_tiles: Float[Array, "3 tile column"],
    linear: Linearised,
    groups: Float[Array, "3 3 tile column"] | None,
    p: Problem,
    free: Array,
    right: NormalVector,
    axis: str | None,
) -> NormalVector:
    """As one device sees it; `all_tiles`: the points of all devices, `groups`: what observations of one point add."""
    o, tiles = p.observations, local_tiles(p.tiles)
    values, kept = image_values(unknowns.images, o), kept_free(p)
    zero = jax.tree.map(lambda f: jnp.zeros(f.shape), kept)

    def total(x: Array) -> Array:
        return lax.psum(x, axis) if axis else x

    def only_free(b: NormalVector) -> NormalVector:
        return jax.tree.map(lambda f, x: jnp.where(f, x, 0.0), NormalVector(kept.images, kept.border, free), b)

    def dot(a: NormalVector, b: NormalVector) -> Array:
        images = jnp.sum(a.images * b.images) + jnp.sum(a.border * b.border)
        return images + total(jnp.sum(a.tiles * b.tiles))

    def moved(t: KeptVector) -> Arranged:
        images = corrected(unknowns.images, correction_of(t.images, t.border, p, unknowns), o.in_angles, o.system)
        return Arranged(images, all_tiles)

    def table(t: KeptVector) -> Float[Array, "image number"]:
        return image_values(moved(t).images, o)

    gradient, _ = _derivatives(o, values, jnp.zeros_like(values), unknowns.tiles, jnp.zeros_like(free, float), tiles)
    gradient = total(gradient)

    def cost(t: KeptVector) -> Array:
        """Of the kept unknowns alone: what is no ray of the tiles, and the rays along their gradient."""
        others = sum((jnp.sum(v * v) for v in other_residuals(moved(t), p)), jnp.zeros(()))
        return 0.5 * others + jnp.sum(gradient * table(t))

    def product(b: NormalVector) -> NormalVector:
        t = KeptVector(b.images, b.border)
        _, along = jax.jvp(table, (zero,), (t,))
        _, (rows, at_points) = _derivatives(o, values, along, unknowns.tiles, b.tiles, tiles)
        (of_rays,) = jax.vjp(table, zero)[1](total(rows))
        _, of_others = jax.jvp(jax.grad(cost), (zero,), (t,))
        if groups is not None:
            at_points = at_points + jnp.stack([jnp.sum(row * b.tiles, 0) for row in groups])
        kept_part = jax.tree.map(jnp.add, of_rays, of_others)
        return only_free(NormalVector(kept_part.images, kept_part.border, at_points))

    normals = factorised_normals(unknowns, linear, p, free, axis)
    found, left = conjugate_gradients(product, normals.solve, only_free(right), dot, TOLERANCE, MOST_ITERATIONS)
    return jax.tree.map(lambda x: jnp.where(left <= TOLERANCE, x, jnp.nan), found)


def _derivatives(
    o: Observations,
    values: Float[Array, "image number"],
    along: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    along_points: Float[Array, "3 tile column"],
    tiles: tuple[Tiles, ...],
) -> tuple[Float[Array, "image number"], tuple[Float[Array, "image number"], Float[Array, "3 tile column"]]]:
    """Of v^T P v / 2 of the rays of one device: the gradient by the numbers of the images, and H times a direction."""
    both, width = jnp.concatenate([values, along], 1), values.shape[1]

    def do_chunk(part: Tiles, c: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        gradient, rows, at_points = carry
        chunk = chunk_of(part, c)
        numbers, tile = at_slots(both, chunk.slot_image), chunk.first_tile + chunk.tile
        old, direction = numbers[:width], numbers[width:]
        rotation, centre, _ = split_values(old)
        point = points_at_cells(chunk, list(points), tile, rotation, centre)
        moved = [jnp.take(x, tile, axis=0, mode="clip") for x in along_points]
        moved = [jnp.where(chunk.used, x, 0.0) for x in moved]

        def cost(numbers: list[Array], x: list[Array]) -> Array:
            v = image_equation(o.model, *split_values(numbers), (x[0], x[1], x[2]), chunk.measured)
            return 0.5 * (jnp.sum((v[0] * chunk.weights[0]) ** 2) + jnp.sum((v[1] * chunk.weights[1]) ** 2))

        derivatives = jax.grad(cost, (0, 1))
        (first, _), (of_images, of_points) = jax.jvp(derivatives, (old, list(point)), (direction, moved))
        zero, sums = jnp.zeros_like(chunk.first_tile), jnp.stack(sum_by_tile(of_points, chunk))
        return (
            gradient.at[chunk.slot_image].add(jnp.concatenate(first, 1), mode="promise_in_bounds"),
            rows.at[chunk.slot_image].add(jnp.concatenate(of_images, 1), mode="promise_in_bounds"),
            lax.dynamic_update_slice(at_points, sums, (zero, chunk.first_tile, zero)),
        )

    carry = jnp.zeros_like(values), jnp.zeros_like(values), jnp.zeros_like(points)
    for part in tiles:
        carry = lax.fori_loop(0, part.chunks, partial(do_chunk, part), carry)
    return carry[0], (carry[1], carry[2])


def _point_hessian(unknowns: Arranged, p: Problem) -> Float[Array, "3 3 tile column"] | None:
    """What observations of one point each add to the blocks of the eliminated points; None where there are none."""
    if not any(group.kind.touches == ("point",) for group in p.observations.groups):
        return None

    def gradient(tiles: Float[Array, "3 tile column"]) -> Float[Array, "3 tile column"]:
        def cost(tiles: Array) -> Array:
            flat, groups = Arranged(unknowns.images, tiles).flat(), p.observations.groups
            single = [group for group in groups if group.kind.touches == ("point",)]
            residuals = [weighted(group_residuals(flat, group), group) for group in single]
            return 0.5 * sum((jnp.sum(v * v) for v in residuals), jnp.zeros(()))

        return jax.grad(cost)(tiles)

    units = jnp.eye(3)[:, :, None, None] * jnp.ones_like(unknowns.tiles)
    return jnp.stack([jax.jvp(gradient, (unknowns.tiles,), (unit,))[1] for unit in units])
