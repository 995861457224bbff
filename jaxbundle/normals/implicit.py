"""The reduced normal equations solved without being formed: preconditioned conjugate gradients.

    S x = A^T P (A x - B u) + lambda D x,    u = V^-1 B^T P A x        a forward and a transposed derivative each

One product runs through all tiles once, like the back-substitution. The preconditioner are the diagonal blocks of S,
one an image and one for the whole border.

For blocks whose factor would be too large or too full. It gives no cofactors.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Observations
from jaxbundle.normals.cells import Tiles, at_slots, chunk_of, points_at_cells, sum_by_tile
from jaxbundle.normals.kept import KeptSums
from jaxbundle.normals.point_blocks import PointFactor, backward, forward
from jaxbundle.normals.rows import image_equation
from jaxbundle.normals.substitute import split_values

TOLERANCE = 1e-12  # of the first residual, in the norm of the preconditioner
MOST_ITERATIONS = 2000


class KeptVector(NamedTuple):
    """A vector of kept unknowns."""

    images: Float[Array, "image d"]
    border: Float[Array, " border"]

    def dot(self, other: "KeptVector") -> Float[Array, ""]:
        """Scalar product."""
        return jnp.sum(self.images * other.images) + jnp.sum(self.border * other.border)


def ray_product(
    observations: Observations,
    before: Float[Array, "image number"],
    direction: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    factors: Float[Array, "tile numbers"],
    tiles: tuple[Tiles, ...],
) -> Float[Array, "image number"]:
    """A^T P (A x - B u) of the rays of one device, by the numbers of `image_values`; `direction` is x."""
    table = jnp.concatenate([before, direction], 1)
    width, n, model = before.shape[1], points.shape[2], observations.model

    def add_chunk(part: Tiles, c: Array, sums: Array) -> Array:
        chunk = chunk_of(part, c)
        numbers = at_slots(table, chunk.slot_image)
        old, along = split_values(numbers[:width]), split_values(numbers[width:])
        point = points_at_cells(chunk, list(points), chunk.first_tile + chunk.tile, old[0], old[1])

        def of_image(rotation, centre, interior):
            return image_equation(model, rotation, centre, interior, point, chunk.measured)

        def of_point(p):
            return image_equation(model, old[0], old[1], old[2], p, chunk.measured)

        def weighted(v):
            return tuple(w * w * x for w, x in zip(chunk.weights, v, strict=True))

        _, ax = jax.jvp(of_image, old, along)
        (at_points,) = jax.vjp(of_point, point)[1](weighted(ax))
        stored = chunk.window(factors)
        factor = PointFactor(*(stored[:, k * n : (k + 1) * n] for k in range(6)))
        own = (jnp.arange(chunk.most_tiles) < chunk.tile_count)[:, None]
        x, y, z = sum_by_tile(list(at_points), chunk)
        u = [jnp.where(own, c, 0.0) for c in backward(factor, forward(factor, (x, y, z)))]
        ux, uy, uz = (jnp.take(c, chunk.tile, axis=0, mode="clip") for c in u)
        _, bu = jax.jvp(of_point, (point,), ((ux, uy, uz),))
        left = weighted([a - b for a, b in zip(ax, bu, strict=True)])
        by_rotation, by_centre, by_interior = jax.vjp(of_image, *old)[1](left)
        rows = jnp.concatenate([*by_rotation, *by_centre, *by_interior], 1)
        return sums.at[chunk.slot_image].add(rows, mode="promise_in_bounds")

    sums = jnp.zeros_like(before)
    for part in tiles:
        sums = lax.fori_loop(0, part.chunks, partial(add_chunk, part), sums)
    return sums


def kept_product(kept: KeptSums, x: KeptVector) -> KeptVector:
    """The part of S x that is no ray of an eliminated point."""
    images = jnp.einsum("iab,ib->ia", kept.diagonal, x.images) + kept.coupling @ x.border
    border = jnp.einsum("iab,ia->b", kept.coupling, x.images) + kept.border @ x.border
    return KeptVector(images, border)
