"""Remeasuring existing rays: all rays of a point with one template, from the given positions.

The template of a point is in the image with the most central viewing direction; its ray is not changed. The start
of the six affine parameters is the image of a small plane through the point that faces these directions, by the image
equation. A ray with a refused match is not changed.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.given import require_a
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.camera.projection import projection
from jaxbundle.imagery.match_types import DEFAULT, MatchOptions, Refusal
from jaxbundle.imagery.ray_sigmas import ray_sigmas
from jaxbundle.imagery.window_pairs import HALF, MAX_SHIFT, PairMatches, PairTable, match_pairs
from jaxbundle.imagery.windows import GreyImages, GreyLevels
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device, tree_with
from jaxbundle.numerics.shapes import grid_size

TEMPLATE = -1  # status of a ray in the image of the template


class Refinement(NamedTuple):
    """Result of remeasuring rays.

    Example:
        >>> jb.imagery.Refinement._fields
        ('block', 'status', 'matches', 'rays')
    """

    block: Block
    """The block with the new image coordinates and standard deviations."""
    status: Int[np.ndarray, " ray"]
    """A `Refusal` as a number: 0 for a remeasured ray; -1 for rays of templates."""
    matches: PairMatches
    """Values of the tried rays, in the order of `rays`."""
    rays: Int[np.ndarray, " pair"]

    @property
    def measured(self) -> Bool[np.ndarray, " ray"]:
        """Mask of the remeasured rays and of the rays of their templates."""
        structure = self.block.structure
        own = self.status == Refusal.MATCHED
        points = np.bincount(structure.ray_point[own], minlength=len(structure.point_names)) > 0
        return own | ((self.status == TEMPLATE) & points[structure.ray_point])

    @property
    def counts(self) -> dict[Refusal, int]:
        """Numbers of tried rays that were measured or refused, for each reason."""
        tried = self.status[self.rays]
        return {reason: int((tried == reason).sum()) for reason in Refusal if (tried == reason).any()}


def refine(
    block: Block,
    images: Mapping[str, GreyLevels],
    *,
    options: MatchOptions = DEFAULT,
    half: int = HALF,
    levels: tuple[int, ...] = (0,),
) -> Refinement:
    """Remeasures the rays of a block in its images by least-squares matching.

    Args:
        block: block with orientations and object points, rays in px.
        images: pyramids by the names of the images; rays of other images are not changed.
        options: options of the matching; the default of `max_shift` is 2 px.
        half: windows have 2 half + 1 px.
        levels: levels of the pyramids, the coarse ones first.

    Returns: the block with new rays. Their standard deviations are three times those of the matching, at least
        0.02 px.

    Raises: BlockError for rays in mm, and if none of the images is given.

    Example:
        >>> images = {name: jb.imagery.pyramid(f"photos/{name}") for name in block.images}  # doctest: +SKIP
        >>> jb.adjust(jb.imagery.refine(block, images).block).sigma0  # doctest: +SKIP
    """
    require_a(Block, block, "imagery.refine")
    _require_images(block, images)
    numbered = {k: images[name] for k, name in enumerate(block.structure.image_names) if name in images}
    greys = GreyImages(numbered)
    template_ray, ray = _pairs_of(block, np.array([i in numbered for i in range(len(block.structure.image_names))]))
    structure, xy = block.structure, np.asarray(block.rays.coordinates)
    affine = _affine(block, template_ray, ray)
    image, predicted = structure.ray_image, xy[ray]
    pairs = PairTable(image[template_ray], image[ray], xy[template_ray], predicted, affine)
    options = options._replace(max_shift=MAX_SHIFT - 1) if options.max_shift is None else options
    found = None
    for level in levels:
        found = match_pairs(greys, pairs, level, options, half)
        pairs = pairs._replace(predicted=found.position, affine=found.affine)
    assert found is not None, "levels are given"
    return _refined(block, found, template_ray, ray)


def _require_images(block: Block, images: Mapping[str, GreyLevels]) -> None:
    structure = block.structure
    problems = [
        Problem(f"camera {camera.name} has its rays in {camera.image_unit}", "give them in px", "cameras")
        for camera in structure.cameras
        if camera.image_unit != "px" or not camera.model.photographs
    ]
    if not any(name in images for name in structure.image_names):
        problems.append(Problem("none of the images of the block was given", "name them as in the block", "images"))
    for k, name in enumerate(structure.image_names):
        camera = structure.cameras[structure.image_camera[k]]
        if name in images and camera.width and camera.height:
            rows, columns = images[name].sizes[0]
            if (rows, columns) != (camera.height, camera.width):
                what = f"image {name} has {columns} x {rows} px, camera {camera.name} {camera.width} x {camera.height}"
                problems.append(Problem(what, "give the measured images, as they are stored", "images"))
    if problems:
        raise BlockError(problems)


def _directions(block: Block) -> Float[np.ndarray, "ray 3"]:
    """Unit vectors from the projection centres to the points of all rays."""
    s = block.structure
    along = np.asarray(block.object_points)[s.ray_point] - np.asarray(block.exterior.projection_centre)[s.ray_image]
    return along / np.linalg.norm(along, axis=1, keepdims=True)


def _means(block: Block, directions: Float[np.ndarray, "ray 3"]) -> Float[np.ndarray, "point 3"]:
    point, count = block.structure.ray_point, len(block.structure.point_names)
    mean = np.stack([np.bincount(point, column, count) for column in directions.T], 1)
    return mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)


def _pairs_of(
    block: Block, there: Bool[np.ndarray, " image"]
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """Pairs of the ray of the template and the measured ray, sorted by the templates' images."""
    structure, directions = block.structure, _directions(block)
    middle = (directions * _means(block, directions)[structure.ray_point]).sum(1)
    usable = there[structure.ray_image] & np.isfinite(middle) & (structure.ray_repeat == 0)
    rays = np.flatnonzero(usable)
    order = rays[np.lexsort((-middle[rays], structure.ray_point[rays]))]
    first = np.ones(len(order), bool)
    first[1:] = structure.ray_point[order][1:] != structure.ray_point[order][:-1]
    template = order[first][np.cumsum(first) - 1]
    template, ray = template[~first], order[~first]
    by_image = np.lexsort((structure.ray_image[ray], structure.ray_image[template]))
    return template[by_image], ray[by_image]


def _affine(
    block: Block, template_ray: Int[np.ndarray, " pair"], ray: Int[np.ndarray, " pair"]
) -> Float[np.ndarray, "pair 2 2"]:
    """Derivatives of the coordinates of a ray with respect to those of its template, on a plane across the rays."""
    structure, unknowns = block.structure, unknowns_of(block)
    count, size = len(ray), grid_size(len(ray))
    normal = _means(block, _directions(block))[structure.ray_point[ray]]
    helper = np.eye(3)[np.argmin(np.abs(normal), 1)]
    u = np.cross(normal, helper)
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-12)
    tangents = np.stack([u, np.cross(normal, u)])  # (2, pair, 3)

    def jacobians(rays: Int[np.ndarray, " pair"]) -> Float[np.ndarray, "pair 2 2"]:
        padded = np.zeros(size, np.int64)
        padded[:count] = rays
        image = structure.ray_image[padded]
        along = np.zeros((2, size, 3))
        along[:, :count] = tangents
        at = (
            np.asarray(unknowns.interior)[:, structure.image_camera[image]],
            np.asarray(unknowns.rotation)[:, image],
            np.asarray(unknowns.centre)[:, image],
            np.asarray(unknowns.points)[:, structure.ray_point[padded]],
            np.moveaxis(along, 2, 1),
        )
        return np.asarray(_derivatives(structure.model, *map(on_device, at), optimised=False))[:count]

    if not count:
        return np.zeros((0, 2, 2))
    of_template, of_ray = jacobians(template_ray), jacobians(ray)
    (a, b), (c, d) = np.moveaxis(of_template, 0, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], 1) / (a * d - b * c)[:, None, None]
    return of_ray @ adjugate


@Compiled
def _derivatives(
    model: CameraModel,
    interior: Float[Array, "element pair"],
    rotation: Float[Array, "9 pair"],
    centre: Float[Array, "3 pair"],
    points: Float[Array, "3 pair"],
    tangents: Float[Array, "2 3 pair"],
) -> Float[Array, "pair 2 2"]:
    """Derivatives of image coordinates along two directions at each point, one column each."""

    def image_of(points: Float[Array, "3 pair"]) -> Float[Array, "2 pair"]:
        vector = photo_vector(tuple(rotation), tuple(centre), tuple(points))
        return jnp.stack(projection(model, tuple(interior), vector))

    columns = [jax.jvp(image_of, (points,), (along,))[1] for along in tangents]
    return jnp.moveaxis(jnp.stack(columns, 1), -1, 0)


def _refined(
    block: Block, found: PairMatches, template_ray: Int[np.ndarray, " pair"], ray: Int[np.ndarray, " pair"]
) -> Refinement:
    structure = block.structure
    xy, sigmas = np.array(block.rays.coordinates), np.array(block.rays.sigmas)
    good = found.matched
    xy[ray[good]] = found.position[good]
    points = len(structure.point_names)
    own, of_templates = ray_sigmas(found.covariance, good, structure.ray_point[ray], points)
    sigmas[ray[good]] = own[good]
    templates = np.unique(template_ray[good])
    sigmas[templates] = of_templates[structure.ray_point[templates]]
    status = np.full(len(xy), int(Refusal.NO_WINDOW))
    status[ray] = found.status
    status[np.unique(template_ray)] = TEMPLATE
    new = tree_with(lambda b: (b.rays.coordinates, b.rays.sigmas), block, (xy, sigmas))
    return Refinement(new, status, found, ray)
