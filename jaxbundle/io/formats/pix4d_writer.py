"""Writing the params folder of Pix4Dmapper: calibrated cameras, exterior orientations, offset, and tie points in px.

m = K [R | -R t] (X - offset)       R world to camera, x right, y down, z forward
"""

from pathlib import Path

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.foreign_block import ForeignCamera, element
from jaxbundle.io.formats.photo_rows import photo_rows, written_names
from jaxbundle.io.formats.written import in_pixels, losses_of_block

NAME_LENGTH = 255  # characters; names with blanks are numbered
EXTERNAL_HEADER = "imageName X Y Z Omega Phi Kappa"
HEADER = (  # eight lines, which readers skip
    "fileName imageWidth imageHeight",
    "camera matrix K [3x3]",
    "radial distortion [3x1]",
    "tangential distortion [2x1]",
    "camera position t [3x1]",
    "camera rotation R [3x3]",
    "camera model m = K [R|-Rt] X",
    "",
)


def _holds(camera: ForeignCamera) -> bool:
    return camera.model is METASHAPE and not element(camera, "K4") and not element(camera, "b2")


def write_pix4d(block: Block, path: Path) -> list[str]:
    """Writes the files into a folder, with its name.

    Returns: sentences about what the format cannot represent.
    """
    written = in_pixels(block, _holds)
    foreign, losses = written.foreign, list(written.losses)
    path.mkdir(parents=True, exist_ok=True)
    images, points = written_names(foreign, path, losses, NAME_LENGTH)
    place = foreign.images.centre
    offset = np.round(place.mean(0)) if len(place) else np.zeros(3)
    turned = rotations.DOWN_FORWARD @ np.swapaxes(foreign.images.rotation, 1, 2)
    angles = np.degrees(rotations.to_angles(foreign.images.rotation))
    external, records = [EXTERNAL_HEADER], list(HEADER)
    for k, name in enumerate(images):
        external.append(f"{name} {_row(place[k])} {_row(angles[k])}")
        camera = foreign.cameras[foreign.images.camera[k]]
        f, b1, x0, y0 = (element(camera, key) for key in ("principal_distance", "b1", "x0", "y0"))
        records += [f"{name} {camera.width} {camera.height}", _row((f + b1, 0, x0)), _row((0, f, y0)), "0 0 1"]
        records.append(_row(element(camera, key) for key in ("K1", "K2", "K3")))
        records.append(_row(element(camera, key) for key in ("P2", "P1")))
        records += [_row(place[k] - offset), *(_row(row) for row in turned[k])]
    for part, rows in (("calibrated_external_camera_parameters.txt", external), ("offset.xyz", [_row(offset)])):
        (path / f"{path.name}_{part}").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (path / f"{path.name}_calibrated_camera_parameters.txt").write_text("\n".join(records) + "\n", encoding="utf-8")
    ties = photo_rows(foreign, points, lambda k: images[k], lambda point, _, x, y: f"{point} {x:.9f} {y:.9f} 1")
    (path / f"{path.name}_tp_pix4d.txt").write_text(ties, encoding="utf-8")
    return [*losses, "coordinates of object points and standard deviations", *losses_of_block(block, frozenset())]


def _row(values) -> str:
    return " ".join(f"{value:.17g}" for value in values)
