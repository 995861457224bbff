"""Forward intersection: approximate coordinates of points from approximate images.

The point closest to its rays, with equal weights of all rays: with projection centres X0 and unit directions d,

    sum (I - d d^T) (X - X0) = 0                      three linear equations per point

(Kraus 2007, ch. 4.1 has this for two images; the sum is the least-squares form for any number of rays.)
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.given import require_a
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry import rotation
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import array_module, is_concrete, on_device, on_host, tree_with
from jaxbundle.numerics.shapes import padded

PARALLEL = 1e-12  # squared sine of the angle between two rays: below this the intersection is determined by rounding


def intersect(block: Block) -> Block:
    """Computes coordinates of all object points without coordinates, from their rays.

    Given coordinates are not changed. Points with parallel rays, or with only one ray, remain NaN. It works with jit
    and vmap.

    Example:
        >>> missing = block.replace(object_points=jnp.full_like(block.object_points, jnp.nan))
        >>> bool(jnp.isfinite(jb.orientation.intersect(missing).object_points).all())
        True
    """
    require_a(Block, block, "orientation.intersect")
    xp, points, ray_point = array_module(block), on_host(block.object_points), block.structure.ray_point
    missing = xp.isnan(points)
    rays = np.flatnonzero(missing.any(1)[ray_point]) if block.concrete else np.arange(len(ray_point))
    if not len(rays):
        return block
    image = block.structure.ray_image[rays]
    directions = _directions(block, rays, image)
    centres = on_host(block.exterior.projection_centre).T[:, image]
    closest = closest_to_rays(directions, centres, ray_point[rays], len(points))
    return tree_with(lambda b: b.object_points, block, xp.where(missing, closest.T, points))


def _directions(
    block: Block, rays: Int[np.ndarray, " ray"], image: Int[np.ndarray, " ray"]
) -> Float[Array | np.ndarray, "3 ray"]:
    """Unit vectors along the rays in the object system; concrete arrays are padded for the program."""
    structure, unknowns = block.structure, unknowns_of(block)
    rotations, interior, coordinates = on_host((unknowns.rotation, unknowns.interior, block.rays.coordinates))
    coordinates, indices = coordinates[rays].T, (image, structure.image_camera[image])
    if block.concrete:
        rotations, interior, coordinates = padded(rotations), padded(interior, 1), padded(coordinates)
        indices = tuple(map(padded, indices))
    values = rotations, interior, coordinates, *(index.astype(np.int32) for index in indices)
    return on_host(_along(structure.model, *on_device(values), optimised=False))[:, : len(rays)]


@Compiled
def _along(
    model: CameraModel,
    rotations: Float[Array, "9 image"],
    interior: Float[Array, "element camera"],
    coordinates: Float[Array, "2 ray"],
    image: Int[Array, " ray"],
    camera: Int[Array, " ray"],
) -> Float[Array, "3 ray"]:
    along = direction(model, tuple(interior[:, camera]), (coordinates[0], coordinates[1]))
    return jnp.stack(rotation.apply(tuple(rotations[:, image]), along))


def closest_to_rays(
    directions: Float[Array | np.ndarray, "3 ray"],
    centres: Float[Array | np.ndarray, "3 ray"],
    ray_point: Int[np.ndarray, " ray"],
    points: int,
) -> Float[Array | np.ndarray, "3 point"]:
    """Solutions of the normal equations of each point, by cofactors; NaN if they are singular."""
    xp = array_module((directions, centres))
    if not centres.shape[1]:
        return xp.full((3, points), xp.nan)
    origin = centres.mean(1, keepdims=True)  # large coordinates lose digits
    x, y, z = directions
    across = xp.stack([1 - x * x, -x * y, -x * z, 1 - y * y, -y * z, 1 - z * z])
    xx, xy, xz, yy, yz, zz = across
    u, v, w = centres - origin
    right = xp.stack([xx * u + xy * v + xz * w, xy * u + yy * v + yz * w, xz * u + yz * v + zz * w])
    sums = xp.stack([_summed(row, ray_point, points) for row in (*across, *right)])
    xx, xy, xz, yy, yz, zz, u, v, w = sums
    c_xx, c_xy, c_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    c_yy, c_yz, c_zz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * c_xx + xy * c_xy + xz * c_xz
    rays = np.bincount(ray_point, minlength=points)
    parallel = determinant <= PARALLEL * np.maximum(rays, 1) ** 3
    scale = 1 / xp.where(parallel, np.nan, determinant)
    solution = xp.stack(
        [c_xx * u + c_xy * v + c_xz * w, c_xy * u + c_yy * v + c_yz * w, c_xz * u + c_yz * v + c_zz * w]
    )
    return solution * scale[None] + origin


def _summed(row: Any, ray_point: Int[np.ndarray, " ray"], points: int) -> Any:
    """Sums over the rays of each point."""
    if is_concrete(row):
        return np.bincount(ray_point, row, points)
    return jnp.zeros(points).at[ray_point].add(row)
