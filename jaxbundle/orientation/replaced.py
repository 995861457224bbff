"""Findings about replaced approximate values."""

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.wording import RADIANS, counted, named
from jaxbundle.numerics.host import on_host
from jaxbundle.orientation.sight import Sight

VERTICAL = 0.7  # cosine: axes within 45 degrees of the vertical
MOST = 0.5  # share of the images


def turned(
    first: Float[np.ndarray, "image 3 3"], second: Float[np.ndarray, "image 3 3"]
) -> Float[np.ndarray, " image"]:
    """Angles of the rotations from the first attitudes to the second, in radians."""
    trace = np.einsum("kij,kij->k", first, second)
    return np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))


def replaced_images(
    block: Block, replaced: Bool[np.ndarray, " image"], now: Sight, by: str = "replaced by a resection from its points"
) -> list[Finding]:
    """The finding about replaced images. `by`: how they were replaced."""
    structure = block.structure
    if not replaced.any():
        return []
    chosen = np.flatnonzero(replaced)
    before = np.stack(
        [on_host(x) for x in structure.rotation_system.rotation_from_angles(*on_host(block.exterior.angles)[chosen].T)],
        -1,
    )
    angle = turned(before.reshape(-1, 3, 3), now.rotation[chosen]) / RADIANS[structure.angle_unit]
    distance = np.linalg.norm(now.centre[chosen] - on_host(block.exterior.projection_centre)[chosen], axis=1)
    order = np.argsort(-angle)
    parts = [
        f"{structure.image_names[chosen[k]]} by {angle[k]:.4g} {structure.angle_unit}"
        f" and {distance[k]:.4g} {structure.object_unit}"
        for k in order
    ]
    what = f"the approximate orientation of {counted(len(parts), 'image')} was {by}: {named(parts)}"
    cure = "correct images.csv: the given values do not agree with the rays"
    subjects = tuple(Subject("images", (structure.image_names[chosen[k]],)) for k in order)
    up = before.reshape(-1, 3, 3)[:, 2, 2], now.rotation[chosen][:, 2, 2]  # of the axis from the object to the image
    overturned = (np.abs(up[0]) > VERTICAL) & (np.abs(up[1]) > VERTICAL) & (up[0] * up[1] < 0)
    ground = np.nanmedian(now.believed[:, 2]) if len(now.believed) else np.nan
    above = on_host(block.exterior.projection_centre)[chosen, 2] > ground, now.centre[chosen, 2] > ground
    overturned &= above[0] != above[1]  # a single attitude may be wrong by half a turn
    mirrored = []
    if overturned.sum() > MOST * len(replaced):  # single images may be wrong by half a turn, but not nearly all
        said = (
            f"control and image coordinates are mirrored: they rotate {counted(int(overturned.sum()), 'image')} of"
            f" {len(replaced)} upside down, so that they look upwards instead of downwards or the reverse"
        )
        mirrored = [
            Finding(
                Kind.MIRRORED, said, "exchange X and Y of the control, or change the sign of y of the rays", subjects
            )
        ]
    return [
        *mirrored,
        Finding(
            Kind.REPAIRED,
            what.replace("its points", "their points") if len(parts) > 1 else what,
            cure,
            subjects,
            float(angle.max()),
            structure.angle_unit,
        ),
    ]


def replaced_points(
    block: Block, replaced: Bool[np.ndarray, " point"], points: Float[np.ndarray, "point 3"], by: str
) -> list[Finding]:
    """The finding about replaced points. `by`: source of the new values, {} for the owner."""
    structure = block.structure
    if not replaced.any():
        return []
    chosen = np.flatnonzero(replaced)
    distance = np.nan_to_num(np.linalg.norm(points[chosen] - on_host(block.object_points)[chosen], axis=1))
    order = np.argsort(-distance)
    parts = [f"{structure.point_names[chosen[k]]} by {distance[k]:.4g} {structure.object_unit}" for k in order]
    by = by.format("its" if len(parts) == 1 else "their")
    what = f"the approximate coordinates of {counted(len(parts), 'point')} were replaced by {by}: {named(parts)}"
    subjects = tuple(Subject("points", (structure.point_names[chosen[k]],)) for k in order)
    return [Finding(Kind.REPAIRED, what, "", subjects, float(distance.max()), structure.object_unit)]


def hopeless_points(block: Block, hopeless: Bool[np.ndarray, " point"]) -> list[Finding]:
    """The finding about points whose rays do not intersect."""
    names = [block.structure.point_names[k] for k in np.flatnonzero(hopeless)]
    if not names:
        return []
    one = len(names) == 1
    what = f"the rays of {counted(len(names), 'point')} do not intersect in front of the cameras: {named(names)}"
    it = "it" if one else "them"
    cure = f"re-measure or remove {it}; the adjustment starts with a distant position"
    return [Finding(Kind.WEAK, what, cure, tuple(Subject("points", (name,)) for name in names))]
