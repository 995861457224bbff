"""The start of an adjustment: its residuals must be finite numbers, otherwise the causes are reported."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.normals.cost import ray_arrays, weighted_residuals
from jaxbundle.normals.from_block import rays_to_block_order
from jaxbundle.normals.plan.elimination_plan import EliminationPlan
from jaxbundle.normals.problem import OrderedUnknowns, Problem as Arrays
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_host

LARGEST = 1e150  # a residual over its sigma: the square is still finite
SAME_PLACE = 1e-12  # share of the size of the block: rounding of a distance


@Compiled
def _residuals(unknowns: OrderedUnknowns, p: Arrays) -> list[Array]:
    return weighted_residuals(unknowns, p)


def require_finite_start(block: Block, plan: EliminationPlan, unknowns: OrderedUnknowns, p: Arrays) -> None:
    """Raises BlockError for points, images and observations whose residuals at the start are not finite.

    `block` has the origin of the unknowns and their start values. Called if v^T P v is not finite.
    """
    parts = _residuals(unknowns, p, optimised=False)
    of_rays = ray_arrays(p)
    rays = on_host(rays_to_block_order(plan, p.observations.model.components, parts[:of_rays]))
    problems = list(_of_rays(block, np.flatnonzero(_is_bad(rays))))
    for group, residuals in zip(block.groups, parts[of_rays:], strict=True):
        name = group.structure.kind.table
        problems += [
            Problem(
                f"the observed value and the value computed from the approximate values differ by {_size(v)} sigmas",
                "correct the value, its sigma, or the approximate coordinates",
                name,
                int(member),
            )
            for member, v in enumerate(on_host(residuals).T[: len(group.structure.indices)])
            if _is_bad(v[None])[0]
        ]
    cure = "check for values that are far too large or too small"
    raise BlockError(problems or [Problem("v^T P v of the approximate values is not a finite number", cure)])


def _is_bad(residuals: Float[np.ndarray, "row component"]) -> Bool[np.ndarray, " row"]:
    return np.logical_not(np.all(np.abs(residuals) <= LARGEST, axis=1))


def _size(residuals: Float[np.ndarray, " component"]) -> str:
    largest = np.abs(residuals).max()
    return f"{largest:.1e}" if np.isfinite(largest) else "more than can be computed"


def _of_rays(block: Block, rays: np.ndarray) -> Iterator[Problem]:
    structure = block.structure
    centres, points = np.asarray(block.exterior.projection_centre), np.asarray(block.object_points)
    image, point = structure.ray_image[rays], structure.ray_point[rays]
    size = np.nanmax(np.abs(np.concatenate([centres, points])), initial=1.0)
    same = np.abs(centres[image] - points[point]).max(1) <= SAME_PLACE * size
    images = np.unique(image[same])
    if len(images) > 1 and (np.ptp(centres[images], axis=0) <= SAME_PLACE * size).all():
        yield Problem(
            f"{len(images)} images have the same approximate projection centre ({_named(structure, images)}), and"
            f" {len(np.unique(point[same]))} points lie in it",
            "give each image its own approximate projection centre",
            "images",
        )
        rays, image, point, same = (x[~same] for x in (rays, image, point, same))
    for k in np.unique(point, return_index=True)[1]:
        who = f"point {structure.point_names[point[k]]}"
        at = f"image {structure.image_names[image[k]]}"
        if same[k]:
            what = f"the approximate coordinates of {who} are those of the projection centre of {at}"
        else:
            what = f"the image coordinates of {who} on {at} cannot be computed from the approximate values"
        cure = "correct the coordinates of the point, the orientation and camera of the image, or the sigma of the ray"
        yield Problem(what, cure, "points" if same[k] else "rays", int(point[k] if same[k] else rays[k]))


def _named(structure: Structure, images: np.ndarray) -> str:
    names = [structure.image_names[i] for i in images[:3]]
    return ", ".join(names) + (", ..." if len(images) > len(names) else "")
