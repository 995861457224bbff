"""Checking the principal distance by the field angle of the camera, which reveals a wrong unit.

The field angle is 2 arctan(d / 2c) with the diagonal d of the format; where the format is unknown, of the rays.
"""

import math

import numpy as np
from jaxtyping import Int

from jaxbundle.block.block import Block, Camera
from jaxbundle.block.findings import Finding, Kind, Severity, Subject

PLAUSIBLE = (10.0, 150.0)  # deg, across the diagonal: from a telephoto lens to a superwide one
POSSIBLE = (1.0, 165.0)  # deg: maximum for image equations with a plane image
LIKELY = (20.0, 125.0)  # deg, limits for a named cause: cameras for measurement
EXTENT = 95.0  # percentile of the rays that estimates the format where it is not given


def interior_findings(block: Block) -> list[Finding]:
    """Findings about cameras whose principal distance does not fit their format."""
    findings = [_of_camera(block, k, rays) for k, rays in enumerate(block.structure.rays_of_camera)]
    return [finding for finding in findings if finding is not None]


def _of_camera(block: Block, k: int, rays: Int[np.ndarray, " ray"]) -> Finding | None:
    camera = block.structure.cameras[k]
    values = dict(zip(camera.model.elements, np.asarray(block.interior.elements)[k].tolist(), strict=False))
    c, pixel = values.get("principal_distance"), values.get("pixel_size", 1.0)
    if c is None or not len(rays):
        return None
    diagonal = _diagonal(block, camera, values, rays) * pixel
    field = _field(diagonal, c)
    if PLAUSIBLE[0] <= field <= PLAUSIBLE[1]:
        return None
    unit = "mm" if camera.principal_distance_in_mm or camera.image_unit == "mm" else camera.image_unit
    known = camera.width is not None and camera.image_unit == "px"
    of = "format" if known else "rays"
    what = (
        f"camera {camera.name}: principal_distance {c:g} {unit} and {of} {diagonal:.4g} {unit} across give a field"
        f" angle of {field:.3g} deg"
    )
    likely = _cause(camera, c, pixel, diagonal)
    impossible = not POSSIBLE[0] <= field <= POSSIBLE[1]
    if not likely and not impossible and _is_alike(block, c):
        return None
    grade = Severity.FAILED if likely or impossible else Severity.CHECK
    subject = (Subject("cameras", (camera.name,), "principal_distance"),)
    cure = likely or "check the principal distance, its unit and the size of the format"
    return Finding(Kind.INTERIOR, what, cure, subject, field, "deg", grade)


def _is_alike(block: Block, c: float) -> bool:
    """Whether other cameras have a similar principal distance, as in collections with one camera for each image."""
    others = np.asarray(block.interior.elements)[:, 0]
    return len(others) > 2 and bool(0.1 < c / np.median(others) < 10)


def _diagonal(block: Block, camera: Camera, values: dict[str, float], rays: Int[np.ndarray, " ray"]) -> float:
    """Diagonal of the format, else of the rays, in the unit of the rays."""
    if camera.width and camera.height and camera.image_unit == "px":
        return math.hypot(camera.width, camera.height)
    xy = np.asarray(block.rays.coordinates)[rays] - [values.get("x0", 0.0), values.get("y0", 0.0)]
    return 2 * float(np.percentile(np.hypot(*xy.T), EXTENT))


def _field(diagonal: float, c: float) -> float:
    return 2 * math.degrees(math.atan2(diagonal / 2, abs(c)))


def _cause(camera: Camera, c: float, pixel: float, diagonal: float) -> str:
    """The number in another unit, if that is likely."""
    metric = camera.principal_distance_in_mm and pixel > 0
    tries = [
        ("pixel_size in micrometres: divide it by 1000", diagonal / 1000, c, metric and pixel >= 0.5),
        (f"principal_distance in px: give {c * pixel:g} mm, or leave pixel_size out", diagonal, c * pixel, metric),
        (f"principal_distance in m: give {c * 1000:g}", diagonal, c * 1000, metric or camera.image_unit == "mm"),
        (f"principal_distance in micrometres: give {c / 1000:g}", diagonal, c / 1000, metric),
    ]
    for words, d, value, possible in tries:
        if possible and LIKELY[0] <= _field(d, value) <= LIKELY[1]:
            return f"likely {words}"
    if camera.image_unit == "px" and not metric and abs(c) < diagonal / 10:
        return "likely principal_distance in mm: give pixel_size in mm with it, or the principal distance in px"
    return ""
