"""Writing a project of Inpho (.prj), with the keys that inpho.py reads.

Cameras are px cameras without distortion: A = ((1/s, 0, x0 - 0.5), (0, -1/s, y0 - 0.5)) with the pixel size s in mm.
Image coordinates are in mm from the principal point, y up. For other lenses they are corrected.
"""

from pathlib import Path

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.io.formats.foreign_block import ForeignBlock, element
from jaxbundle.io.formats.photo_rows import written_names
from jaxbundle.io.formats.written import NOMINAL_PIXEL, foreign_block, in_pixels, is_free, losses_of_block

NAME_LENGTH = 40  # maximum number of characters of a point or photo
TIME = "00:00:00 01/01/2000"  # time of an orientation, which a block does not have
POINT = "1.00 2 { * }"  # standard deviation and kind of a measured point, as in other writers
FULL = 3  # kind of a control point in plan and height


def write_inpho(block: Block, path: Path) -> list[str]:
    """Writes a project as one file.

    Returns: sentences about what the format cannot represent.
    """
    own, written = foreign_block(block), in_pixels(block, is_free)
    foreign = written.foreign
    losses = [words for words in written.losses if "mm are written" not in words]
    sizes = [element(c, "pixel_size") if c.image_unit == "px" else NOMINAL_PIXEL for c in own.cameras]
    sizes = [NOMINAL_PIXEL if size == 1.0 else size for size in sizes]
    path.parent.mkdir(parents=True, exist_ok=True)
    images, points = written_names(foreign, path.parent, losses, NAME_LENGTH)
    rows = ["$PROJECT 5.0.0", f"  $PROJECT_NAME : {path.stem}", "  $LINEAR_UNITS_IMAGE : mm", "  $ANGULAR_UNITS : deg"]
    rows += ["$END", *_cameras(foreign, sizes), *_photos(foreign, sizes, images, points)]
    rows += _points(foreign, points, losses)
    path.write_text("\r\n".join(rows) + "\r\n", encoding="utf-8", newline="")
    if foreign.coordinate_system:
        losses.append("the coordinate system: set it in the project")
    return [*losses, "standard deviations of image coordinates", *losses_of_block(block, frozenset({"control"}))]


def _cameras(foreign: ForeignBlock, sizes: list[float]) -> list[str]:
    rows = []
    for camera, size in zip(foreign.cameras, sizes, strict=True):
        x0, y0, c = (element(camera, name) for name in ("x0", "y0", "principal_distance"))
        rows += ["$CAMERA_DEFINITION", f"  $ID : {camera.name}", "  $KIND : CCDFrame"]
        rows += [f"  $CCD_COLUMNS : {camera.width}", f"  $CCD_ROWS : {camera.height}"]
        rows += ["  $PIXEL_REFERENCE : CenterTopLeft", "  $CAMERA_MOUNT_ROTATION : 0", "  $ACTIVE_CALIBRATION : 1"]
        rows += ["  $CALIBRATION_SET :", "    $ID : 1", "    $CCD_INTERIOR_ORIENTATION :"]
        rows += [f"      {1 / size:.17g} 0 {x0 - 0.5:.17g}", f"      0 {-1 / size:.17g} {y0 - 0.5:.17g}"]
        rows += [f"    $FOCAL_LENGTH : {c * size:.17g}", "    $PRINCIPAL_POINT_PPA : 0 0", "    $END", "  $END", "$END"]
    return rows


def _photos(foreign: ForeignBlock, sizes: list[float], images: tuple[str, ...], points: tuple[str, ...]) -> list[str]:
    rows, rays = [], foreign.rays
    order = np.argsort(rays.image, kind="stable")
    ends = np.searchsorted(rays.image[order], np.arange(len(images) + 1)).tolist()
    for k, name in enumerate(images):
        camera, size = foreign.cameras[foreign.images.camera[k]], sizes[foreign.images.camera[k]]
        rows += ["$PHOTO", f"  $PHOTO_NUM : {name}", f"  $PHOTO_FILE : {foreign.images.names[k]}"]
        rows += [f"  $CAMERA_ID : {camera.name}", f"  $EXT_ORI : {TIME}"]
        rows.append(f"    {_row([element(camera, 'principal_distance') * size, *foreign.images.centre[k]])}")
        rows += [f"    {_row(row)}" for row in foreign.images.rotation[k].T]
        rows.append("  $PHOTO_POINTS :")
        middle = np.array([element(camera, "x0"), element(camera, "y0")])
        mine = order[ends[k] : ends[k + 1]]
        xy = (rays.xy[mine] - middle) * [size, -size]
        for point, (x, y) in zip(rays.point[mine].tolist(), xy.tolist(), strict=True):
            rows.append(f"    {points[point]} {x:.9f} {y:.9f} {POINT}")
        rows += ["    $END_POINTS", "$END"]
    return rows


def _points(foreign: ForeignBlock, points: tuple[str, ...], losses: list[str]) -> list[str]:
    position, rows = dict(zip(foreign.points.names, points, strict=True)), ["$CONTROL_POINTS"]
    for row in foreign.control:
        if row.check or not np.isfinite(row.coordinates).all():
            why = "which is a check point" if row.check else "of which not all coordinates are known"
            losses.append(f"control point {row.name}, {why}")
        else:
            rows.append(f"  {position[row.name]} {_row(row.coordinates)} {FULL} {_row(np.nan_to_num(row.sigmas))}")
    rows += ["$END_POINTS", "$ADJUSTED_POINTS"]
    places = zip(points, foreign.points.coordinates, strict=True)
    rows += [f"  {name} {_row(place)}" for name, place in places if np.isfinite(place).all()]
    return [*rows, "$END_POINTS"]


def _row(values) -> str:
    return " ".join(f"{value:.15g}" for value in values)
