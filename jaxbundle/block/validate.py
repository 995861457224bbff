"""What must hold of a block before it is adjusted; all that does not is told at once."""

import numpy as np
from jaxtyping import Int

from jaxbundle.block.block import Block
from jaxbundle.block.datum import datum_defect, insufficient, is_located
from jaxbundle.block.problems import BlockError, Problem


def validate(block: Block) -> list[Problem]:
    """Problems of a block whose values are concrete, in the order in which they are best cured."""
    problems = [*_unusable_values(block), *_weak_images(block), *_weak_points(block)]
    return problems or [*_redundancy(block), *_datum(block)]


def require_valid(block: Block) -> None:
    """Raises BlockError with all problems of the block."""
    problems = validate(block)
    if problems:
        raise BlockError(problems)


def _observed_of(block: Block, touched: str, size: int) -> Int[np.ndarray, " entity"]:
    """Number of group III observations that touch each point or image."""
    count = np.zeros(size, int)
    for group in block.groups:
        structure = group.structure
        for k, kind in enumerate(structure.kind.touches):
            if kind == touched:
                np.add.at(count, structure.indices[:, k], structure.observed.sum(1))
    return count


def _unusable_values(block: Block) -> list[Problem]:
    structure = block.structure
    tables = [
        ("images", np.c_[block.exterior.projection_centre, block.exterior.angles], "give the image approximate values"),
        ("cameras", block.interior.elements, "give the camera its interior elements"),
        ("points", block.object_points, "give the point coordinates, or rays on two images that intersect"),
        ("rays", block.rays.coordinates, "give both image coordinates or drop the ray"),
        *((group.structure.kind.name, group.values, "give the value or drop the row") for group in block.groups),
    ]
    names = {"images": structure.image_names, "points": structure.point_names}
    problems = []
    for table, values, cure in tables:
        for row in np.nonzero(~np.isfinite(np.asarray(values)).all(1))[0]:
            who = f"{table[:-1]} {names[table][row]}" if table in names else "the row"
            problems.append(Problem(f"{who} has a value that is no finite number", cure, table, int(row)))
    sigmas = [("rays", block.rays.sigmas), *((group.structure.kind.name, group.sigmas) for group in block.groups)]
    for table, values in sigmas:
        values = np.asarray(values)
        for row in np.nonzero(~(np.isfinite(values) & (values > 0)).all(1))[0]:
            problems.append(Problem("a sigma is not positive", "give a positive standard deviation", table, int(row)))
    return problems


def _weak_images(block: Block) -> list[Problem]:
    structure = block.structure
    rays = np.bincount(structure.ray_image, minlength=len(structure.image_names))
    known = 2 * rays + _observed_of(block, "image", len(rays))
    return [
        Problem(
            f"image {structure.image_names[i]} has {rays[i]} rays, too few for its {free} unknown elements",
            "measure at least 3 points on it, better 6, or drop the image",
            "images",
            int(i),
        )
        for i, free in enumerate(structure.exterior_free.sum(1))
        if known[i] < free
    ]


def _weak_points(block: Block) -> list[Problem]:
    structure = block.structure
    rays = np.bincount(structure.ray_point, minlength=len(structure.point_names))
    known = 2 * rays + _observed_of(block, "point", len(rays))
    problems = []
    for p in np.nonzero(known < structure.point_free.sum(1))[0]:
        images = {0: "no image", 1: "one image only"}.get(int(rays[p]), f"{rays[p]} images")
        row = np.nonzero(structure.ray_point == p)[0]
        problems.append(
            Problem(
                f"point {structure.point_names[p]} is seen on {images}",
                "give it coordinates, measure it on a second image or drop it",
                "rays" if len(row) else "points",
                int(row[0]) if len(row) else None,
            )
        )
    return problems


def _redundancy(block: Block) -> list[Problem]:
    unknowns = block.structure.unknowns
    to_be_held = 7 if block.structure.datum.kind == "open" and not is_located(block) else 0
    if block.observations > unknowns - to_be_held:
        return []
    after = f", {unknowns - to_be_held} with the datum held" if to_be_held else ""
    return [
        Problem(
            f"{block.observations} observations do not exceed {unknowns} unknowns{after}: M > N is needed",
            "measure more points common to the images, or hold the interior elements of the cameras",
        )
    ]


def _datum(block: Block) -> list[Problem]:
    if not is_located(block):
        return []
    defect = datum_defect(block)
    return [insufficient(defect)] if defect.count else []
