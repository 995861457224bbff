"""Forward intersection: approximate coordinates of points from approximate images.

The point closest to its rays, all rays of the same weight: with projection centres X0 and unit directions d,

    sum (I - d d^T) (X - X0) = 0                      three linear equations a point

(Kraus 2007, ch. 4.1 intersects so in two images; the sum is its least-squares form for any number of rays.)
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.camera.model import ImagePoint
from jaxbundle.geometry import rotation
from jaxbundle.numerics.host import on_device

NEWTON_STEPS = 10  # a correction of the measurement needs one, a strong distortion of the projection about six
PARALLEL = 1e-12  # squared sine of the angle between two rays: below, it is rounding that makes them meet


def intersect(block: Block) -> Block:
    """The block with coordinates for every object point that has none, from its rays.

    A coordinate that is given is kept. Points whose rays are parallel, or that have one ray only, stay NaN.
    """
    points = np.asarray(block.object_points)
    missing = np.isnan(points)
    rays = np.flatnonzero(np.any(missing, axis=1)[block.structure.ray_point])
    if not len(rays):
        return block
    image = block.structure.ray_image[rays]
    directions = np.asarray(_directions(block, on_device(rays), on_device(image)))
    centres = np.asarray(block.exterior.projection_centre).T[:, image]
    closest = _closest_to_rays(directions, centres, block.structure.ray_point[rays], len(points))
    return eqx.tree_at(lambda b: b.object_points, block, on_device(np.where(missing, closest.T, points)))


@eqx.filter_jit
def _directions(block: Block, rays: Int[Array, " ray"], image: Int[Array, " ray"]) -> Float[Array, "3 ray"]:
    """Unit vectors in the object system along the rays.

    The photo vector (a, b, -1) is the one whose residual vanishes, by Newton's method: any camera model has an inverse.
    """
    structure, unknowns = block.structure, unknowns_of(block)
    interior = tuple(unknowns.interior[:, jnp.asarray(structure.image_camera)[image]])
    measured = tuple(block.rays.coordinates[rays].T)
    one, zero = jnp.ones_like(measured[0]), jnp.zeros_like(measured[0])

    def residual(a: Array, b: Array) -> ImagePoint:
        return structure.model.residual(interior, (a, b, -one), measured)

    def step(_: Int[Array, ""], vector: tuple[Array, Array]) -> tuple[Array, Array]:
        (vx, vy), (xa, ya) = jax.jvp(residual, vector, (one, zero))
        _, (xb, yb) = jax.jvp(residual, vector, (zero, one))
        determinant = xa * yb - xb * ya
        return vector[0] - (yb * vx - xb * vy) / determinant, vector[1] - (xa * vy - ya * vx) / determinant

    a, b = jax.lax.fori_loop(0, NEWTON_STEPS, step, (zero, zero))
    length = jnp.sqrt(a * a + b * b + 1)
    return jnp.stack(rotation.apply(tuple(unknowns.rotation[:, image]), (a / length, b / length, -1 / length)))


def _closest_to_rays(
    directions: Float[np.ndarray, "3 ray"],
    centres: Float[np.ndarray, "3 ray"],
    ray_point: Int[np.ndarray, " ray"],
    points: int,
) -> Float[np.ndarray, "3 point"]:
    """Solutions of the normal equations point by point, by cofactors; NaN where they are singular."""
    origin = centres.mean(1, keepdims=True)  # large coordinates lose digits
    x, y, z = directions
    across = np.stack([1 - x * x, -x * y, -x * z, 1 - y * y, -y * z, 1 - z * z])
    xx, xy, xz, yy, yz, zz = across
    u, v, w = centres - origin
    right = np.stack([xx * u + xy * v + xz * w, xy * u + yy * v + yz * w, xz * u + yz * v + zz * w])
    sums = np.stack([np.bincount(ray_point, row, points) for row in (*across, *right)])
    xx, xy, xz, yy, yz, zz, u, v, w = sums
    c_xx, c_xy, c_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    c_yy, c_yz, c_zz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * c_xx + xy * c_xy + xz * c_xz
    rays = np.bincount(ray_point, minlength=points)
    parallel = determinant <= PARALLEL * np.maximum(rays, 1) ** 3
    scale = 1 / np.where(parallel, np.nan, determinant)
    solution = np.stack(
        [c_xx * u + c_xy * v + c_xz * w, c_xy * u + c_yy * v + c_yz * w, c_xz * u + c_yz * v + c_zz * w]
    )
    return solution * scale + origin
