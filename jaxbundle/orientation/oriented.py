"""Orientations of many images from directions and points with possible gross errors.

Each image is adjusted from all its points and from random groups of a few points; the result with the minimum median of
the angles is used (least median of squares, Rousseeuw and Leroy 1987, ch. 5). As the rays are directions, a camera
without distortion and with principal distance 1 represents all cameras, and all blocks use one compiled program.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.camera.brown import DISTORTION_FREE
from jaxbundle.geometry.rotation import RotationSystem
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device
from jaxbundle.orientation.resections import resection
from jaxbundle.orientation.sight import Sight, angle_off
from jaxbundle.solve.adjustment import Status

IMAGES, POINTS = 24, 24  # images of one call and points of each: one program for all
GROUP = 6  # points of a group: four and two checks
GROUPS = 11  # with 20 % wrong points, one of 11 groups of 6 is correct with 97 %
LEAST = 4
UNIT_CAMERA = (1.0, 0.0, 0.0, 1.0, 1.0)  # c, x0, y0, pixel_size, y_axis


class Oriented(NamedTuple):
    """Orientations of images; `median`: median of the angles in radians, NaN without orientation.

    `behind`: share of the points behind the camera.
    """

    rotation: Float[np.ndarray, "image 3 3"]
    angles: Float[np.ndarray, "image 3"]
    centre: Float[np.ndarray, "image 3"]
    median: Float[np.ndarray, " image"]
    behind: Float[np.ndarray, " image"]


class _Task(NamedTuple):
    """One resection of an image, with a number of points."""

    image: int
    rays: Int[np.ndarray, " ray"]


def oriented(
    sight: Sight,
    images: Int[np.ndarray, " chosen"],
    points: Float[np.ndarray, "point 3"],
    usable: Bool[np.ndarray, " ray"],
    system: RotationSystem,
) -> Oriented:
    """Resects chosen images from the usable rays; NaN for images with fewer than four points or without a result."""
    rng = np.random.default_rng(0)  # a fixed seed: the same block gives the same start
    by_image = {int(i): np.flatnonzero(usable & (sight.image == i)) for i in images}
    tasks: list[_Task] = []
    for i, rays in by_image.items():
        if len(rays) >= LEAST:
            tasks.append(_Task(i, rays if len(rays) <= POINTS else rng.choice(rays, POINTS, replace=False)))
            if len(rays) > GROUP:
                tasks += [_Task(i, rng.choice(rays, GROUP, replace=False)) for _ in range(GROUPS)]
    count = len(images)
    best = Oriented(_nan(count, 3, 3), _nan(count, 3), _nan(count, 3), _nan(count), _nan(count))
    place = {int(i): k for k, i in enumerate(images)}
    for first in range(0, len(tasks), IMAGES):
        part = tasks[first : first + IMAGES]
        for task, rotation, centre, angles in zip(part, *_resected(sight, part, points, system), strict=True):
            if not np.isfinite(centre).all():
                continue
            rays, k = by_image[task.image], place[task.image]
            vector = (points[sight.point[rays]] - centre) @ rotation
            median = np.median(angle_off(sight.plane[rays], vector))
            if not median >= best.median[k]:
                best.rotation[k], best.centre[k], best.angles[k] = rotation, centre, angles
                best.median[k], best.behind[k] = median, (vector[:, 2] >= 0).mean()
    return best


def _nan(*shape: int) -> np.ndarray:
    return np.full(shape, np.nan)


def _resected(
    sight: Sight, tasks: list[_Task], points: Float[np.ndarray, "point 3"], system: RotationSystem
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations, centres and angles of the tasks of one call; NaN for failed resections."""
    object_points, plane = np.zeros((IMAGES, POINTS, 3)), np.zeros((IMAGES, POINTS, 2))
    sigmas, origin = np.full((IMAGES, POINTS, 2), np.inf), np.zeros((IMAGES, 3))
    for k in range(IMAGES):
        rays = tasks[min(k, len(tasks) - 1)].rays
        origin[k] = points[sight.point[rays]].mean(0)
        object_points[k, : len(rays)] = points[sight.point[rays]] - origin[k]
        plane[k, : len(rays)], sigmas[k, : len(rays)] = sight.plane[rays], 1.0
    arrays = (on_device(x) for x in (object_points, plane, sigmas))
    rotation, centre, angles, status = (np.asarray(x) for x in _many(system, *arrays, optimised=False))
    centre = np.where((status == int(Status.CONVERGED))[:, None], centre + origin, np.nan)
    return rotation[: len(tasks)].reshape(-1, 3, 3), centre[: len(tasks)], angles[: len(tasks)]


@Compiled
def _many(
    system: RotationSystem,
    points: Float[Array, "image point 3"],
    plane: Float[Array, "image point 2"],
    sigmas: Float[Array, "image point 2"],
) -> tuple[Array, Array, Array, Array]:
    found = jax.vmap(lambda x, y, s: resection(DISTORTION_FREE, jnp.array(UNIT_CAMERA), x, y, s, system=system))(
        points, plane, sigmas
    )
    rotation = jnp.stack(system.rotation_from_angles(*found.angles.T), -1)
    return rotation, found.projection_centre, found.angles, found.status
