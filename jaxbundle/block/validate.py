"""Validation of a block before its adjustment; all problems are reported at once."""

import numpy as np
from jaxtyping import Bool, Int

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.consistency import inconsistencies
from jaxbundle.block.datum import inner_needs_none, is_located
from jaxbundle.block.datum_defect import datum_defect, insufficient
from jaxbundle.block.first_residuals import unusable_models
from jaxbundle.block.given import require_a
from jaxbundle.block.magnitudes import absurd_numbers, unusable_numbers
from jaxbundle.block.problems import BlockError, Problem


def validate(block: Block) -> list[Problem]:
    """Problems of a concrete block, in the best order to solve them.

    Example:
        >>> jb.blocks.validate(block)
        []
    """
    require_a(Block, block, "blocks.validate")
    wrong = inconsistencies(block)
    if wrong:
        return wrong  # no other check is possible
    problems = [*_unusable_values(block), *_unusable_sigmas(block), *weaknesses(block)]
    problems = problems or unusable_numbers(block) or absurd_numbers(block) or unusable_models(block)
    return problems or [*_redundancy(block), *_datum(block)]


def weaknesses(block: Block) -> list[Problem]:
    """Problems of images and points with too few observations; values are not used."""
    return [*_weak_images(block), *_weak_points(block)]


def require_valid(block: Block) -> None:
    """Raises BlockError with all problems of the block."""
    problems = validate(block)
    if problems:
        raise BlockError(problems)


def _observed_of(block: Block, touched: str, size: int) -> Int[np.ndarray, " entity"]:
    """Number of observations other than rays that touch each point or image."""
    count = np.zeros(size, int)
    for group in block.groups:
        structure = group.structure
        for k, kind in enumerate(structure.kind.touches):
            if kind == touched:
                np.add.at(count, structure.indices[:, k], structure.observed.sum(1))
    return count


def _unusable_values(block: Block) -> list[Problem]:
    """Problems of values that are not finite; missing coordinates of weak points are reported elsewhere."""
    structure = block.structure
    no_number = "has a value that is not a finite number"
    orientations = np.c_[block.exterior.projection_centre, block.exterior.angles]
    points = np.where(_is_weak_point(block)[:, None], 0.0, block.object_points)
    cameras = [f"camera {camera.name}" for camera in structure.cameras]
    images = [f"image {name}" for name in structure.image_names]
    tables = [
        ("cameras", block.interior.elements, cameras, no_number, "add the interior elements of the camera"),
        (
            "images",
            orientations,
            images,
            "has no orientation",
            "measure at least 8 points on it that are also on other images, give approximate values, or call"
            " jb.approximate(block)",
        ),
        ("rays", block.rays.coordinates, None, no_number, "give both image coordinates or drop the ray"),
        *((g.structure.kind.table, g.values, None, no_number, "give the value or drop the row") for g in block.groups),
    ]
    problems = [
        Problem(f"{who[row] if who else 'the row'} {what}", cure, table, int(row))
        for table, values, who, what, cure in tables
        for row in np.nonzero(~np.isfinite(np.asarray(values)).all(1))[0]
    ]
    return problems + [
        Problem(
            f"point {structure.point_names[p]} has no coordinates and its rays do not intersect",
            "give it approximate coordinates, measure it on an image from a different position or drop it",
            "points",
            int(p),
        )
        for p in np.nonzero(~np.isfinite(points).all(1))[0]
    ]


def _unusable_sigmas(block: Block) -> list[Problem]:
    sigmas = [("rays", block.rays.sigmas), *((group.structure.kind.table, group.sigmas) for group in block.groups)]
    return [
        Problem("a sigma is not positive", "give a positive standard deviation", table, int(row))
        for table, values in sigmas
        for row in np.nonzero(~(np.isfinite(values) & (np.asarray(values) > 0)).all(1))[0]
    ]


def _coordinates(structure: Structure) -> int:
    """Number of residuals of a ray; that of photographs if no camera exists yet."""
    return structure.model.components if structure.cameras else 2


def _weak_images(block: Block) -> list[Problem]:
    structure = block.structure
    first = structure.ray_repeat == 0  # a repeated point on an image does not add information about the image
    rays = np.bincount(structure.ray_image[first], minlength=len(structure.image_names))
    known = _coordinates(structure) * rays + _observed_of(block, "image", len(rays))
    return [
        Problem(
            f"image {structure.image_names[i]} has {rays[i]} {'ray' if rays[i] == 1 else 'rays'}, "
            f"too few for its {free} unknown elements",
            "measure at least 3 points on it, better 6, or drop the image",
            "images",
            int(i),
        )
        for i, free in enumerate(structure.exterior_free.sum(1))
        if known[i] < free
    ]


def _is_weak_point(block: Block) -> Bool[np.ndarray, " point"]:
    """Problems of points with fewer observations than unknown coordinates."""
    structure = block.structure
    first = structure.ray_repeat == 0
    rays = np.bincount(structure.ray_point[first], minlength=len(structure.point_names))
    return _coordinates(structure) * rays + _observed_of(block, "point", len(rays)) < structure.point_free.sum(1)


def _weak_points(block: Block) -> list[Problem]:
    structure = block.structure
    first_ray = np.full(len(structure.point_names), -1)
    first_ray[structure.ray_point[::-1]] = np.arange(len(structure.ray_point))[::-1]
    return [
        Problem(
            f"point {structure.point_names[p]} is seen on {'no image' if first_ray[p] < 0 else 'one image only'}",
            "give it control coordinates, measure it on a second image or drop it",
            "points" if first_ray[p] < 0 else "rays",
            int(p if first_ray[p] < 0 else first_ray[p]),
        )
        for p in np.nonzero(_is_weak_point(block))[0]
    ]


def _redundancy(block: Block) -> list[Problem]:
    unknowns = block.structure.n_unknowns
    to_be_held = 7 if block.structure.datum.kind in ("open", "inner") and not is_located(block) else 0
    if block.n_observations > unknowns - to_be_held:
        return []
    after = f", {unknowns - to_be_held} with a fixed datum" if to_be_held else ""
    return [
        Problem(
            f"{block.n_observations} observations do not exceed {unknowns} unknowns{after}: M > N is required",
            "measure more points common to the images, or fix the interior elements of the cameras",
        )
    ]


def _datum(block: Block) -> list[Problem]:
    if not is_located(block):
        return []
    if block.structure.datum.kind == "inner":
        return [inner_needs_none()]
    defect = datum_defect(block)
    return [insufficient(defect)] if defect.count else []
