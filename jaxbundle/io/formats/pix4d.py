"""Reading the params folder of Pix4Dmapper, with image measurements in one of three forms.

    *_calibrated_external_camera_parameters.txt    header; image X Y Z omega phi kappa, deg, project system
    *_calibrated_camera_parameters.txt             8 lines, then 10 for each image: name W H; K; R1 R2 R3; T1 T2; t; R
    *_offset.xyz                                   the shift subtracted from the coordinates of the second file
    *_tp_pix4d.txt                                 image, then point x y [scale] px, -99 after each image
    *_bingo.txt, *_orima.txt                       the same points in mm from the image centre, y up; often thinned

R = R_x R_y R_z of the angles; K in px from the corner; R1 R2 R3, T1 T2 of OpenCV: P1 = T2, P2 = T1.
Source: Pix4D, support articles 202558969 and 203590305.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.collected import IN_PX, Collected
from jaxbundle.io.formats.foreign_block import DEFAULT, ForeignBlock, ForeignCamera, ReadOptions
from jaxbundle.io.formats.orima import read_orima_rows
from jaxbundle.io.formats.photo_rows import read_photo_rows
from jaxbundle.io.formats.source import AGAIN, lines_of, numbers
from jaxbundle.io.noted import Noted

EXTERNAL, CAMERAS = "*_calibrated_external_camera_parameters.txt", "*_calibrated_camera_parameters.txt"
HEADER, RECORD = 8, 10  # lines per image in the file of cameras


class Calibration(NamedTuple):
    """The calibrated camera of an image: size, K, radial and tangential coefficients."""

    width: int
    height: int
    matrix: Float[np.ndarray, "3 3"]
    radial: list[float]
    tangential: list[float]

    @property
    def elements(self) -> dict[str, float]:
        """Interior elements of the model `metashape`."""
        k = self.matrix
        terms = dict(zip(("K1", "K2", "K3"), self.radial, strict=True))
        terms |= dict(zip(("P2", "P1"), self.tangential, strict=True))
        return {"principal_distance": k[1, 1], "b1": k[0, 0] - k[1, 1], "x0": k[0, 2], "y0": k[1, 2], **terms}


def is_pix4d(path: Path) -> bool:
    """Whether a folder contains the exterior orientations of Pix4Dmapper."""
    return path.is_dir() and next(path.glob(EXTERNAL), None) is not None


def read_pix4d(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the block of a params folder.

    Raises: BlockError with all problems, or without image measurements.
    """
    noted, found = Noted(), Collected()
    external = next(iter(sorted(path.glob(EXTERNAL))))
    _external(external, found, noted)
    cameras = _calibrations(path, noted)
    if noted:
        raise noted.error()
    if not cameras and options.interior is None:
        what = f"{path.name} has no {CAMERAS}, which has the interior orientations"
        raise BlockError([Problem(what, "add it, or give --interior F,X0,Y0 in px and --image-size W,H")])
    one = _given(options)
    _measurements(path, (found, noted), {name: cameras.get(name, one) for name in found.images}, options)
    if noted:
        raise noted.error()
    distinct: dict[tuple, str] = {}
    used = []
    for name in found.images:
        calibration = cameras.get(name, one)
        if calibration is None:
            raise BlockError([Problem(f"image {name} has no interior orientation", f"add it to {CAMERAS}")])
        key = (calibration.width, calibration.height, *calibration.elements.values())
        if key not in distinct:
            distinct[key] = f"camera {len(distinct) + 1}"
            size = calibration.width or None, calibration.height or None
            estimate = (
                "principal_distance",
                "x0",
                "y0",
                *(k for k, v in calibration.elements.items() if v and k[0] in "KP"),
            )
            estimate = estimate if cameras else ()
            used.append(ForeignCamera(distinct[key], METASHAPE, calibration.elements, estimate, "px", *size))
        found.camera[name] = distinct[key]
    images = found.images_with(list(distinct.values()), lambda rows: rotations.from_angles(np.radians(rows)))
    return ForeignBlock(
        format="Pix4D params folder",
        name=external.name.removesuffix(EXTERNAL[1:]) or path.resolve().name,
        cameras=tuple(used),
        images=images,
        points=found.points_found(),
        rays=found.ray_table(),
        assumptions=(IN_PX,),
    )


def _given(options: ReadOptions) -> Calibration | None:
    if options.interior is None:
        return None
    f, x0, y0 = options.interior
    width, height = options.image_size or (0, 0)
    return Calibration(width, height, np.array([[f, 0, x0], [0, f, y0], [0, 0, 1]]), [0.0] * 3, [0.0] * 2)


def _external(path: Path, found: Collected, noted: Noted) -> None:
    for line, text in enumerate(lines_of(path), 1):
        fields = text.rsplit(None, 6)
        if line == 1 or not text.strip():
            continue
        if len(fields) != 7:
            noted.add(path.name, line, f"the row has {len(fields)} fields, not image X Y Z omega phi kappa", AGAIN)
            continue
        values = numbers(path, line, fields[1:], noted)
        if values is not None:
            found.image(fields[0])
            found.orientation[fields[0]] = np.array(values[:3]), np.array(values[3:])


def _calibrations(path: Path, noted: Noted) -> dict[str, Calibration]:
    """Reads the calibrated camera of each image."""
    files = [file for file in sorted(path.glob(CAMERAS)) if "external" not in file.name]
    if not files:
        return {}
    lines = lines_of(files[0])
    cameras = {}
    at = HEADER
    while at + RECORD <= len(lines) and lines[at].strip():
        head = lines[at].rsplit(None, 2)
        rows = [numbers(files[0], at + k + 1, lines[at + k].split(), noted) for k in range(1, RECORD)]
        size = numbers(files[0], at + 1, head[1:], noted) if len(head) == 3 else None
        shape = [len(row or ()) for row in rows]
        if size is None or shape != [3, 3, 3, 3, 2, 3, 3, 3, 3] or not all(1 <= side < 1e8 for side in size):
            noted.add(
                files[0].name, at + 1, "the image is not name W H, K, R1 R2 R3, T1 T2, t and R in ten lines", AGAIN
            )
            return cameras
        numbers_ = [row or [] for row in rows]
        cameras[head[0]] = Calibration(int(size[0]), int(size[1]), np.array(numbers_[:3]), numbers_[3], numbers_[4])
        at += RECORD
    return cameras


def _measurements(
    path: Path, into: tuple[Collected, Noted], cameras: dict[str, Calibration | None], options: ReadOptions
) -> None:
    """Reads the rays of the most complete of the three files."""
    found, noted = into
    stems = {Path(name).stem: name for name in cameras}
    pixels = next(iter(sorted(path.glob("*_tp_pix4d.txt"))), None)
    if pixels is not None:
        own = Collected()
        read_photo_rows(pixels, own, noted)
        for image, point, x, y in _named(own):
            found.ray(stems.get(Path(image).stem, image), point, x, y)
        return
    own = Collected()
    bingo, orima = (next(iter(sorted(path.glob(f"*_{form}.txt"))), None) for form in ("bingo", "orima"))
    if bingo is not None:
        sizes = _heads(bingo)
        read_photo_rows(bingo, own, noted)
    elif orima is not None:
        sizes = {}
        read_orima_rows(orima, own, noted)
    else:
        what = f"{path.name} has no image measurements"
        raise BlockError([Problem(what, "export tie points: *_tp_pix4d.txt, *_bingo.txt or *_orima.txt")])
    _in_pixels(found, own, (stems, cameras, sizes, options.pixel_size))


def _named(own: Collected) -> list[tuple[str, str, float, float]]:
    images, points = tuple(own.images), tuple(own.points)
    return [(images[i], points[p], x, y) for i, p, x, y in own.rays]


def _heads(path: Path) -> dict[str, tuple[float, float]]:
    """Width and height of the images in mm, from H_h_w or H_w_h after their names."""
    sizes = {}
    for text in lines_of(path):
        fields = text.split()
        if len(fields) == 2 and fields[1].startswith("H_") and fields[1].count("_") == 2:
            try:
                one, other = (float(field) for field in fields[1].split("_")[1:])
            except ValueError:
                continue
            if one > 0 and other > 0:
                sizes[fields[0]] = (one, other)
    return sizes


def _in_pixels(found: Collected, own: Collected, known: tuple) -> None:
    """Converts rays from mm to px, by the sizes of the images in mm and in px."""
    stems, cameras, sizes, pixel = known
    for image, point, x, y in _named(own):
        name = stems.get(Path(image).stem, image)
        calibration, size = cameras.get(name), sizes.get(image)
        if calibration is None:
            continue
        if not calibration.width or size is None and pixel is None:
            what = f"the size of image {name} in px and in mm is not known"
            raise BlockError([Problem(what, "export *_tp_pix4d.txt, or give --image-size W,H and --pixel-size MM")])
        area = calibration.width * calibration.height
        per_mm = 1 / pixel if size is None else math.sqrt(area / (size[0] * size[1]))
        found.ray(name, point, calibration.width / 2 + x * per_mm, calibration.height / 2 - y * per_mm)
