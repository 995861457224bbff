"""Selecting the usable images, points and rays of a foreign block; unusable ones are counted and reported."""

import dataclasses

import numpy as np
from jaxtyping import Bool

from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.block.wording import counted
from jaxbundle.io.formats.foreign_block import ForeignBlock, Images, Points, RayTable

MIN_RAYS = 3  # minimum number of rays of an image: six unknowns
NAMED = 10


def usable(foreign: ForeignBlock) -> ForeignBlock:
    """The block without images that have no orientation or too few rays, and without points that one ray sees."""
    images, points, rays = foreign.images, foreign.points, foreign.rays
    oriented = images.oriented
    known = {known.name for known in foreign.control if not known.check and np.isfinite(known.coordinates).all()}
    anchored = np.array([name in known for name in points.names], bool)
    image, point, ray = _selected(foreign, oriented, anchored)
    findings = [*_images_left(foreign, oriented, image), *_points_left(foreign, ray, point)]
    number_of_image, number_of_point = np.cumsum(image) - 1, np.cumsum(point) - 1
    names = tuple(name for name, kept in zip(images.names, image, strict=True) if kept)
    cameras = np.unique(images.camera[image])
    chosen = Images(names, np.searchsorted(cameras, images.camera[image]), images.rotation[image], images.centre[image])
    left = Points(tuple(np.array(points.names, object)[point]), points.coordinates[point])
    sigma = None if rays.sigma is None else rays.sigma[ray]
    table = RayTable(number_of_image[rays.image[ray]], number_of_point[rays.point[ray]], rays.xy[ray], sigma)
    there, points_there = set(names), set(left.names)
    return dataclasses.replace(
        foreign,
        cameras=tuple(foreign.cameras[k] for k in cameras),
        images=chosen,
        points=left,
        rays=table,
        control=tuple(row for row in foreign.control if row.name in points_there),
        stations=tuple(row for row in foreign.stations if row.name in there),
        attitudes=tuple(row for row in foreign.attitudes if row.name in there),
        distances=tuple(row for row in foreign.distances if {row.start, row.end} <= points_there),
        findings=(*foreign.findings, *findings, *_known_left(foreign, there, points_there)),
    )


def _selected(
    foreign: ForeignBlock, oriented: Bool[np.ndarray, " image"], anchored: Bool[np.ndarray, " point"]
) -> tuple[Bool[np.ndarray, " image"], Bool[np.ndarray, " point"], Bool[np.ndarray, " ray"]]:
    """Masks of the images, points and rays that remain. Removal of one may leave too few rays for another."""
    rays = foreign.rays
    ray = oriented[rays.image] if len(rays.image) else np.zeros(0, bool)
    while True:
        seen = np.bincount(rays.point[ray], minlength=len(anchored))
        point = (seen >= 2) | (anchored & (seen >= 1))
        measured = np.bincount(rays.image[ray & point[rays.point]], minlength=len(oriented))
        image = oriented & (measured >= MIN_RAYS)
        left = ray & point[rays.point] & image[rays.image]
        if left.sum() == ray.sum():
            return image, point, left
        ray = left


def _images_left(
    foreign: ForeignBlock, oriented: Bool[np.ndarray, " image"], chosen: Bool[np.ndarray, " image"]
) -> list[Finding]:
    findings = []
    for which, why in ((~oriented, "have no orientation"), (oriented & ~chosen, f"have fewer than {MIN_RAYS} rays")):
        names = [foreign.images.names[k] for k in np.flatnonzero(which)]
        if names:
            subjects = tuple(Subject("images", (name,)) for name in names[:1000])
            what = f"{counted(len(names), 'image')} of {len(chosen)} are not used, because they {why}: {_listed(names)}"
            findings.append(Finding(Kind.UNUSED, what, "", subjects, grade=Severity.NOTE))
    return findings


def _points_left(
    foreign: ForeignBlock, chosen: Bool[np.ndarray, " ray"], point: Bool[np.ndarray, " point"]
) -> list[Finding]:
    rays, points = int((~chosen).sum()), int((~point).sum())
    if not rays and not points:
        return []
    what = (
        f"{counted(points, 'point')} of {len(point)} with fewer than two rays and {counted(rays, 'ray')} of"
        f" {len(chosen)} are not used"
    )
    return [Finding(Kind.UNUSED, what, grade=Severity.NOTE)]


def _known_left(foreign: ForeignBlock, images: set[str], points: set[str]) -> list[Finding]:
    findings = []
    for what, rows, there in (
        ("control points", foreign.control, points),
        ("stations", foreign.stations, images),
        ("attitudes", foreign.attitudes, images),
    ):
        names = [row.name for row in rows if row.name not in there]
        if names:
            why = "are measured on too few images" if what == "control points" else "belong to no image of the block"
            left = f"{len(names)} of {len(rows)} {what} {why} and are not used: {_listed(names)}"
            cure = "compare their names with those of the images" if what != "control points" else ""
            grade = Severity.CHECK if len(names) == len(rows) else Severity.NOTE
            findings.append(Finding(Kind.UNUSED, left, cure, grade=grade))
    return findings


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
