"""Checking whether the rays are inside the format of their camera, and whether they fill it.

px cameras have their origin in the top left corner, x to the right, y down: inside is 0 <= x <= width and
0 <= y <= height.
Where rays are outside, or cover only a small part of the format, common confusions are tried: the likely cause is the
one that puts all rays inside. Approximate orientations detect confusions that the format cannot show (mirrored
coordinates, half resolution).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.block.wording import counted, named
from jaxbundle.numerics.host import tree_with
from jaxbundle.orientation.alternatives import explains, left
from jaxbundle.orientation.sight import sight_of

MARGIN = 0.01  # share of the format: marks on the border of scanned film lie slightly outside
FEW = 0.01  # maximum share of rays outside that are treated as single errors
SLIVER = 0.1  # share of width and of height: blocks with at least ten rays fill more
MIN_RAYS = 10
HALF_FULL = (0.25, 0.5 + 2 * MARGIN)  # share of the format that rays of an image of half resolution can reach
Coordinates = Float[np.ndarray, "ray 2"]


class _Format(NamedTuple):
    """The format of a camera in px, and the size of a pixel in mm (0 if unknown)."""

    camera: int
    width: float
    height: float
    pixel_size: float

    @property
    def size(self) -> Float[np.ndarray, "2"]:
        return np.array([self.width, self.height], float)

    @property
    def words(self) -> str:
        return f"{self.width:g} x {self.height:g} px"


def format_findings(block: Block) -> list[Finding]:
    """Findings about rays outside their format, and rays that cover only a small part of it."""
    findings, xy = [], np.asarray(block.rays.coordinates)
    for form in _formats(block):
        rays = block.structure.rays_of_camera[form.camera]
        if len(rays):
            findings += _of_camera(block, form, rays, xy[rays])
    return findings


def _formats(block: Block) -> list[_Format]:
    formats = []
    for k, camera in enumerate(block.structure.cameras):
        if camera.image_unit == "px" and camera.width and camera.height:
            elements = camera.model.elements
            pixel = float(block.interior.elements[k, elements.index("pixel_size")]) if "pixel_size" in elements else 1.0
            formats.append(_Format(k, camera.width, camera.height, pixel if camera.principal_distance_in_mm else 0.0))
    return formats


def _outside(form: _Format, xy: Coordinates) -> Bool[np.ndarray, " ray"]:
    margin = MARGIN * form.size
    return np.asarray(~((xy >= -margin) & (xy <= form.size + margin)).all(1))


def _fills(form: _Format, xy: Coordinates) -> bool:
    return bool((np.ptp(xy, axis=0) > SLIVER * form.size).any())


def _of_camera(block: Block, form: _Format, rays: Int[np.ndarray, " ray"], xy: Coordinates) -> list[Finding]:
    """Findings about one camera: a common cause for all its rays, or single rays."""
    camera = block.structure.cameras[form.camera].name
    outside = _outside(form, xy)
    sliver = len(rays) >= MIN_RAYS and not _fills(form, xy)
    count = int(outside.sum())
    if not count and not sliver:
        return _half_resolution(block, form, rays, xy)
    subject = (Subject("cameras", (camera,)),)
    if count <= FEW * len(rays) and not sliver:
        return [_single(block, form, rays[outside])]
    where = f"{count} of {len(rays)} rays lie outside the format {form.words} of camera {camera}"
    if not count:
        extent = " x ".join(f"{x:.4g}" for x in np.ptp(xy, axis=0))
        where = f"the {len(rays)} rays of camera {camera} fill {extent} of its {form.words}"
    for words, cure, changed in _causes(block, form):
        new = changed(xy)
        if not _outside(form, new).any() and (_fills(form, new) or len(rays) < MIN_RAYS):
            return [
                Finding(
                    Kind.FORMAT,
                    f"{where}; none would {words}" if count else f"{where}; they would fill it {words}",
                    cure,
                    subject,
                    count,
                    "rays",
                )
            ]
    cure = f"check image_unit, width and height of camera {camera}, and the origin of its image coordinates"
    return [Finding(Kind.FORMAT, where, cure, subject, count, "rays")]


def _single(block: Block, form: _Format, rays: Int[np.ndarray, " ray"]) -> Finding:
    s, xy = block.structure, np.asarray(block.rays.coordinates)[rays]
    far = np.maximum(np.maximum(-xy, xy - form.size), 0).max(1)
    order = np.argsort(-far)
    names = [(s.image_names[s.ray_image[rays[k]]], s.point_names[s.ray_point[rays[k]]]) for k in order]
    listing = named(
        [f"point {point} on image {image} by {far[k]:.4g} px" for (image, point), k in zip(names, order, strict=True)]
    )
    what = f"{counted(len(rays), 'ray')} outside the format {form.words}: {listing}"
    subjects = tuple(Subject("rays", name) for name in names)
    return Finding(Kind.FORMAT, what, "re-measure or remove", subjects, float(far.max()), "px", Severity.CHECK)


def _causes(block: Block, form: _Format) -> list[tuple[str, str, Callable[[Coordinates], Coordinates]]]:
    """Possible confusions: words, cure and the corrected coordinates."""
    half = form.size / 2
    first = _exchanged_first(block, form)
    exchange = [
        ("with x and y exchanged", "exchange the columns x and y of rays.csv", lambda xy: xy[:, ::-1]),
        (
            "with width and height exchanged",
            "exchange width and height in block.toml, and the two numbers of principal_point",
            lambda xy: xy[:, ::-1],
        ),
    ]
    causes = exchange[:1] if first == "rays" else exchange[1:] if first == "format" else [_either(*exchange)]
    causes.append(
        (
            "with the origin in the centre of the image",
            f"add {half[0]:g} to x and {half[1]:g} to y, or give the coordinates from the top left corner",
            lambda xy: xy + half,
        )
    )
    if form.pixel_size:
        causes.append(
            (
                "as mm from the principal point",
                'give image_unit = "mm" for this camera',
                lambda xy: xy / form.pixel_size * [1, -1] + half,
            )
        )
    causes += [
        ("with y upwards", "px have their origin top left and y down: give -y", lambda xy: xy * [1, -1]),
        ("as shares of width and height", "multiply x by the width and y by the height", lambda xy: xy * form.size),
        ("as shares of the longer side", "multiply x and y by the longer side", lambda xy: xy * form.size.max()),
    ]
    return causes


def _either(rays: tuple, form: tuple) -> tuple:
    return "with x and y, or width and height, exchanged", f"{rays[1]}, or {form[1]}", rays[2]


def _exchanged_first(block: Block, form: _Format) -> str:
    """Selects the exchange for which the rays agree with the approximate orientations, as the format cannot decide."""
    images = block.structure.image_camera == form.camera
    exchanged = tree_with(lambda b: b.rays.coordinates, block, np.asarray(block.rays.coordinates)[:, ::-1])
    elements = np.array(block.interior.elements)
    names = block.structure.cameras[form.camera].model.elements
    if "x0" not in names:
        return ""
    x, y = names.index("x0"), names.index("y0")
    elements[form.camera, [x, y]] = elements[form.camera, [y, x]]
    turned = tree_with(lambda b: b.interior.elements, block, elements)
    by_rays, by_format = (np.nanmedian(left(sight_of(b))[images]) for b in (exchanged, turned))
    if by_rays < 0.5 * by_format:
        return "rays"
    return "format" if by_format < 0.5 * by_rays else ""


def _half_resolution(block: Block, form: _Format, rays: Int[np.ndarray, " ray"], xy: Coordinates) -> list[Finding]:
    """Finding about images with all rays in the upper left quarter that would agree at twice the size."""
    s = block.structure
    image = s.ray_image[rays]
    extent = np.zeros((len(s.image_names), 2))
    np.maximum.at(extent, image, xy / form.size)
    count = np.bincount(image, minlength=len(extent))
    low, high = HALF_FULL
    small = (count >= MIN_RAYS) & (extent >= low).all(1) & (extent <= high).all(1)
    if not small.any() or (small | (count == 0)).all():
        return []
    coordinates = np.array(block.rays.coordinates)
    coordinates[small[s.ray_image]] *= 2
    twice = tree_with(lambda b: b.rays.coordinates, block, coordinates)
    small &= explains(left(sight_of(twice)), left(sight_of(block)))
    names = [s.image_names[k] for k in np.flatnonzero(small)]
    if not names:
        return []
    camera = s.cameras[form.camera].name
    what = (
        f"the rays of {counted(len(names), 'image')} lie in a quarter of the format {form.words} of camera {camera} and"
        f" would agree with their points at twice the size: {named(names)}"
    )
    cure = "give images of another resolution their own camera"
    return [Finding(Kind.FORMAT, what, cure, tuple(Subject("images", (name,)) for name in names))]
