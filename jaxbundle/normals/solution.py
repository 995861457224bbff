"""N^-1 b: the undamped normal equations solved for right-hand sides of any kind.

    [ U    W ] [t]   [b_t]        u = V^-1 b_X                               images' rows:  S t = b_t - W u
    [ W^T  V ] [X] = [b_X]        X = V^-1 (b_X - W^T t),   W = A^T P B      never formed: a forward and a transposed
                                                                             derivative of the image equation

One elimination serves all right-hand sides. Functions of the unknowns get their variances from it, derivatives of the
adjusted unknowns too, and a free network its S-transformation.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Observations
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import ImagePoint
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.cells import Tiles, at_slots, chunk_of, points_at_cells, sum_by_tile
from jaxbundle.normals.eliminate import eliminate
from jaxbundle.normals.point_blocks import PointFactor, backward, forward
from jaxbundle.normals.reduced_system import ReducedFactor, factorise, solve
from jaxbundle.normals.rows import image_equation
from jaxbundle.normals.step import (
    Linearised,
    correction_of,
    direction_of,
    kept_rows,
    linearise,
    local_tiles,
    partition,
    reduced_system,
)
from jaxbundle.normals.substitute import image_values, split_values
from jaxbundle.normals.vector import NormalVector
from jaxbundle.numerics.devices import AXIS, device_mesh


def solve_normals(unknowns: Arranged, p: Problem, right: NormalVector) -> NormalVector:
    """N^-1 b for every vector of the leading axis; not finite where N is singular."""
    linear, free = linearise(unknowns, p), p.free_tiles
    if p.devices == 1:
        return _on_device(unknowns, linear, p, free, right, None)
    everywhere: Any = PartitionSpec()
    of_tiles: Any = PartitionSpec(None, None, AXIS)
    vectors = NormalVector(everywhere, everywhere, of_tiles)
    unknown_parts, linear_parts, problem_parts = partition(unknowns, linear, p)
    return jax.shard_map(
        partial(_on_device, axis=AXIS),
        mesh=device_mesh(p.devices),
        in_specs=(unknown_parts, linear_parts, problem_parts, PartitionSpec(None, AXIS), vectors),
        out_specs=vectors,
        check_vma=False,
    )(unknowns, linear, p, free, right)


class FactorisedNormals(NamedTuple):
    """The undamped normal equations as one device has them; `axis` names the devices, None for a single one."""

    unknowns: Arranged
    problem: Problem
    values: Float[Array, "image number"]
    turns: Float[Array, "9 3 image"]
    reduced: ReducedFactor
    points: PointFactor
    axis: str | None

    def solve(self, b: NormalVector) -> NormalVector:
        """N^-1 b."""
        p, tiles, points = self.problem, local_tiles(self.problem.tiles), self.unknowns.tiles
        o = p.observations
        rows = to_images(o, self.values, points, self._eliminated(b.tiles), tiles)
        coupled = kept_rows(lax.psum(rows, self.axis) if self.axis else rows, self.turns, p)
        images, border = solve(
            p.reduced, self.reduced, (b.images - coupled.images)[..., None], (b.border - coupled.border)[:, None]
        )
        direction = direction_of(correction_of(images[..., 0], border[:, 0], p, self.unknowns), self.turns)
        at_points = to_points(o, self.values, image_values(direction, o), points, tiles)
        return NormalVector(images[..., 0], border[:, 0], self._eliminated(b.tiles - at_points))

    def _eliminated(self, b: Float[Array, "3 tile column"]) -> Float[Array, "3 tile column"]:
        """V^-1 b."""
        return jnp.stack(backward(self.points, forward(self.points, (b[0], b[1], b[2]))))


def factorised_normals(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, axis: str | None
) -> FactorisedNormals:
    """Eliminates the points of this device and factorises the reduced equations."""
    o, tiles, zero = p.observations, local_tiles(p.tiles), jnp.zeros(())
    rays, factors = eliminate(
        o, linear.table, unknowns.tiles, linear.prior, free, zero, tiles, p.shape, p.diagonal_pair
    )
    system = reduced_system(lax.psum(rays, axis) if axis else rays, linear.kept, p).system
    n = unknowns.tiles.shape[2]
    points = PointFactor(*(factors[:, k * n : (k + 1) * n] for k in range(6)))
    factor = factorise(p.reduced, system, zero)
    return FactorisedNormals(unknowns, p, image_values(unknowns.images, o), linear.turns, factor, points, axis)


def _on_device(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, right: NormalVector, axis: str | None
) -> NormalVector:
    return lax.map(factorised_normals(unknowns, linear, p, free, axis).solve, right)


def to_images(
    o: Observations,
    values: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    u: Float[Array, "3 tile column"],
    tiles: tuple[Tiles, ...],
) -> Float[Array, "image number"]:
    """W u = A^T P B u of the rays of one device, by the numbers of `image_values`."""

    def add_chunk(part: Tiles, c: Array, sums: Array) -> Array:
        chunk = chunk_of(part, c)
        old = split_values(at_slots(values, chunk.slot_image))
        tile = chunk.first_tile + chunk.tile
        point = points_at_cells(chunk, list(points), tile, old[0], old[1])
        x, y, z = (jnp.take(coordinate, tile, axis=0, mode="clip") for coordinate in u)

        def of_point(point: Vector) -> ImagePoint:
            return image_equation(o.model, old[0], old[1], old[2], point, chunk.measured)

        def of_image(rotation: Rotation, centre: Vector, interior: tuple[Scalar, ...]) -> ImagePoint:
            return image_equation(o.model, rotation, centre, interior, point, chunk.measured)

        _, bu = jax.jvp(of_point, (point,), ((x, y, z),))
        _, transposed = jax.vjp(of_image, *old)
        left = tuple(jnp.where(w > 0, w * w * v, 0.0) for w, v in zip(chunk.weights, bu, strict=True))
        by_rotation, by_centre, by_interior = transposed(left)
        rows = jnp.concatenate([*by_rotation, *by_centre, *by_interior], 1)
        return sums.at[chunk.slot_image].add(rows, mode="promise_in_bounds")

    sums = jnp.zeros_like(values)
    for part in tiles:
        sums = lax.fori_loop(0, part.chunks, partial(add_chunk, part), sums)
    return sums


def to_points(
    o: Observations,
    values: Float[Array, "image number"],
    direction: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    tiles: tuple[Tiles, ...],
) -> Float[Array, "3 tile column"]:
    """W^T t = B^T P A t of the rays of one device; `direction` is t, by the numbers of `image_values`."""
    table, width = jnp.concatenate([values, direction], 1), values.shape[1]

    def do_chunk(part: Tiles, c: Array, done: Array) -> Array:
        chunk = chunk_of(part, c)
        numbers = at_slots(table, chunk.slot_image)
        old, along = split_values(numbers[:width]), split_values(numbers[width:])
        point = points_at_cells(chunk, list(points), chunk.first_tile + chunk.tile, old[0], old[1])

        def of_image(rotation: Rotation, centre: Vector, interior: tuple[Scalar, ...]) -> ImagePoint:
            return image_equation(o.model, rotation, centre, interior, point, chunk.measured)

        _, moved = jax.jvp(of_image, old, along)
        _, transposed = jax.vjp(lambda p: image_equation(o.model, old[0], old[1], old[2], p, chunk.measured), point)
        (at_points,) = transposed(tuple(w * w * v for w, v in zip(chunk.weights, moved, strict=True)))
        zero = jnp.zeros_like(chunk.first_tile)
        sums = jnp.stack(sum_by_tile(list(at_points), chunk))
        return lax.dynamic_update_slice(done, sums, (zero, chunk.first_tile, zero))

    done = jnp.zeros_like(points)
    for part in tiles:
        done = lax.fori_loop(0, part.chunks, partial(do_chunk, part), done)
    return done
