"""Models of two photographs each: relative orientation from approximate values, model points and their covariances.

A model has the system of its first photograph, with the projection centre as origin. The length
of the base is the approximate one. With independent normal numbers e (of the five elements) and u (of the four image
coordinates of a point), all of variance 1, a model point has the errors

    dx = C e + R u              e = sum E u over the points of the model

C: common errors of all points of the model; R: errors of the single point. The least-squares intersection and the
y-parallax are independent, and only the parallaxes determine the five elements; so e and R u are independent.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device
from jaxbundle.numerics.shapes import grid_size
from jaxbundle.orientation import coplanarity
from jaxbundle.orientation.coplanarity import CAUCHY, Pair, Rays
from jaxbundle.orientation.pair_search import sides

ROBUST_STEPS, FINAL_STEPS = 15, 15
REJECTED = 4.0  # limit in robust standard deviations of a y-parallax: one normal error in 16 thousand exceeds it
NORMAL_MEDIAN = 0.6745  # median of the absolute value of a standard normal number
SMALLEST = 1e-12  # relative eigenvalue of the normal equations with a unit diagonal


class Models(NamedTuple):
    """Models with padded points, on the host. Lengths in the object unit."""

    pair: Int[np.ndarray, "model 2"]
    """Indices of the first and the second image."""
    ray: Int[np.ndarray, "model point 2"]
    """Rays of each point in both images; -1 in empty rows."""
    point: Int[np.ndarray, "model point"]
    """Index of the object point; -1 in empty rows."""
    used: Bool[np.ndarray, "model point"]
    """Mask of fitting points; the others have large y-parallaxes or lie behind a photograph."""
    rotation: Float[np.ndarray, "model 3 3"]
    """Matrix model_from_image of the second photograph."""
    base: Float[np.ndarray, "model 3"]
    """The second projection centre in the model."""
    coordinates: Float[np.ndarray, "model point 3"]
    """Coordinates of the model points."""
    shared: Float[np.ndarray, "model point 3 5"]
    """The derivatives C of the points."""
    shared_base: Float[np.ndarray, "model 3 5"]
    """The derivatives C of the second projection centre."""
    shared_angles: Float[np.ndarray, "model 3 5"]
    """Derivatives of small rotations of the second photograph, about the axes of the model, with respect to e."""
    own: Float[np.ndarray, "model point 3 4"]
    """The derivatives R with respect to both image coordinates in the first and in the second image."""
    elements: Float[np.ndarray, "model point 5 4"]
    """E."""
    parallaxes: Float[np.ndarray, "model point"]
    """y-parallaxes in units of their standard deviations."""

    def __len__(self) -> int:  # number of models, not of fields
        return len(self.pair)


class _Found(NamedTuple):
    """The values of one model."""

    used: Any
    rotation: Any
    base: Any
    coordinates: Any
    shared: Any
    shared_base: Any
    shared_angles: Any
    own: Any
    elements: Any
    parallaxes: Any


def form_models(block: Block, pairs: Int[np.ndarray, "model 2"]) -> Models:
    """Forms the models of pairs of images, from the approximate orientations of the block."""
    structure = block.structure
    ray = _common_rays(block, pairs)
    vectors, back = (np.asarray(x) for x in _planes(*_measured(block), optimised=False))
    valid, rays = ray[:, :, 0] >= 0, np.maximum(ray, 0)
    unknowns = unknowns_of(block)
    matrices = np.asarray(unknowns.rotation).T.reshape(-1, 3, 3)
    first, second = pairs.T
    between = np.asarray(block.exterior.projection_centre)[second] - np.asarray(block.exterior.projection_centre)[first]
    length = np.linalg.norm(between, axis=1)
    rotation = np.einsum("mji,mjk->mik", matrices[first], matrices[second])
    base = np.einsum("mji,mj->mi", matrices[first], between) / length[:, None]
    arrays = (vectors[rays[:, :, 0]], vectors[rays[:, :, 1]], back[rays[:, :, 0]], back[rays[:, :, 1]], valid)
    found = [
        _formed(*map(on_device, (r, b, s)), tuple(on_device(a[m]) for a in arrays), optimised=False)
        for m, (r, b, s) in enumerate(zip(rotation, base, length, strict=True))
    ]
    stacked = _Found(*(np.stack([np.asarray(getattr(f, name)) for f in found]) for name in _Found._fields))
    point = np.where(valid, structure.ray_point[rays[:, :, 0]], -1)
    return Models(np.asarray(pairs), ray, point, *stacked)


def _common_rays(block: Block, pairs: Int[np.ndarray, "model 2"]) -> Int[np.ndarray, "model point 2"]:
    """The rays of the common points of each pair; the first one for a point that is measured twice on an image."""
    structure = block.structure
    once = np.flatnonzero(structure.ray_repeat == 0)
    by_image = [once[structure.ray_image[once] == i] for i in range(len(structure.image_names))]
    rows = []
    for i, j in pairs:
        a, b = by_image[i], by_image[j]
        _, at, to = np.intersect1d(structure.ray_point[a], structure.ray_point[b], return_indices=True)
        rows.append(np.stack([a[at], b[to]], 1))
    padded = np.full((len(pairs), grid_size(max(map(len, rows), default=0)), 2), -1)
    for row, into in zip(rows, padded, strict=True):
        into[: len(row)] = row
    return padded


def _measured(block: Block) -> tuple[CameraModel, Array, Array, Array]:
    """Camera model, and for each ray its interior elements, coordinates and sigmas, padded."""
    structure, rays = block.structure, block.rays
    at = np.zeros(grid_size(len(structure.ray_image)), int)
    at[: len(structure.ray_image)] = np.arange(len(structure.ray_image))
    camera = structure.image_camera[structure.ray_image[at]]
    interior = np.asarray(unknowns_of(block).interior)[:, camera]
    return (
        structure.model,
        on_device(interior),
        on_device(np.asarray(rays.coordinates)[at].T),
        on_device(np.asarray(rays.sigmas)[at]),
    )


@Compiled
def _planes(model: CameraModel, interior: Array, measured: Array, sigmas: Array) -> tuple[Array, Array]:
    """Photo vectors (a, b, -1), and matrices that convert normal numbers of variance 1 to errors of (a, b)."""
    along = direction(model, tuple(interior), (measured[0], measured[1]))
    plane = jnp.stack([-along[0] / along[2], -along[1] / along[2]], 1)

    def residual(ab: Array, elements: Array, xy: Array) -> Array:
        return jnp.stack(model.residual(tuple(elements), (ab[0], ab[1], -jnp.ones(())), (xy[0], xy[1])))

    jacobians = jax.vmap(jax.jacfwd(residual))(plane, interior.T, measured.T)
    (a, b), (c, d) = jacobians[:, 0].T, jacobians[:, 1].T
    inverse = jnp.stack([d, -b, -c, a], 1).reshape(-1, 2, 2) / (a * d - b * c)[:, None, None]
    return jnp.concatenate([plane, -jnp.ones_like(plane[:, :1])], 1), inverse * sigmas[:, None, :]


@Compiled
def _formed(rotation: Array, base: Array, length: Array, arrays: tuple[Array, ...]) -> _Found:
    """Forms one model."""
    first, second, back1, back2, valid = arrays
    rays = Rays(first, second, back1 @ back1.swapaxes(1, 2), back2 @ back2.swapaxes(1, 2), valid)
    at, _ = coplanarity.refined(Pair(rotation, base), rays, CAUCHY, ROBUST_STEPS)
    size = jnp.abs(coplanarity.parallaxes(at, rays))
    spread = jnp.nanmedian(jnp.where(valid, size, jnp.nan)) / NORMAL_MEDIAN
    used = valid & (size < REJECTED * jnp.maximum(spread, 1.0)) & sides(at, rays)[0]
    at, _ = coplanarity.refined(at, rays, coplanarity.squares(used), FINAL_STEPS)
    r = coplanarity.parallaxes(at, rays)
    _, normals, _, rows = coplanarity.normal_equations(at, rays, coplanarity.squares(used))
    scale = 1 / jnp.sqrt(jnp.diagonal(normals))
    values, vectors = jnp.linalg.eigh(normals * scale[:, None] * scale[None])
    factor = scale[:, None] * vectors / jnp.sqrt(jnp.where(values > SMALLEST * values[-1], values, jnp.nan))[None]
    planes = jnp.concatenate([first[:, :2], second[:, :2]], 1)

    def shifted(planes: Array) -> Rays:
        return rays._replace(first=first.at[:, :2].set(planes[:, :2]), second=second.at[:, :2].set(planes[:, 2:]))

    def points(d: Array, planes: Array) -> Array:
        return length * coplanarity.model_points(coplanarity.changed(at, d), shifted(planes))

    def own(function: Callable[[Array], Array]) -> Array:
        """Derivatives of the values of each point with respect to its four numbers."""
        columns = [jnp.zeros_like(planes).at[:, k].set(1.0) for k in range(4)]
        by_plane = jnp.stack([jax.jvp(function, (planes,), (column,))[1] for column in columns], -1)
        return jnp.concatenate([by_plane[..., :2] @ back1, by_plane[..., 2:] @ back2], -1)

    nothing = jnp.zeros(coplanarity.UNKNOWNS)
    of_points = jax.jacfwd(points)(nothing, planes) @ factor
    of_base = jax.jacfwd(lambda d: length * coplanarity.changed(at, d).base)(nothing) @ factor
    of_angles = jnp.concatenate([jnp.eye(3), jnp.zeros((3, 2))], 1) @ factor
    of_rays = own(lambda p: points(nothing, p))
    of_parallaxes = own(lambda p: coplanarity.parallaxes(at, shifted(p))[:, None])[:, 0]
    elements = -jnp.where(used[:, None, None], (rows @ factor)[:, :, None] * of_parallaxes[:, None, :], 0.0)
    return _Found(
        used,
        at.rotation,
        length * at.base,
        points(nothing, planes),
        of_points,
        of_base,
        of_angles,
        of_rays,
        elements,
        r,
    )
