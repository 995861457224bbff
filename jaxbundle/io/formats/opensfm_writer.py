"""Writing a block as a reconstruction of OpenSfM: reconstruction.json and tracks.csv."""

import json
from pathlib import Path

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.foreign_block import ForeignCamera, element
from jaxbundle.io.formats.opensfm import FILE, RADIAL, TANGENTIAL, TRACKS, VERSION
from jaxbundle.io.formats.written import in_pixels, losses_of_block

SCALE, GREY = 0.001, (128, 128, 128)  # of features with unknown size and colour
HOLDS: frozenset[str] = frozenset()


def holds(camera: ForeignCamera) -> bool:
    """Whether the model `brown` of OpenSfM is this camera: no shear, three radial terms."""
    return camera.model is METASHAPE and not element(camera, "b2") and not element(camera, "K4")


def write_opensfm(block: Block, path: Path) -> list[str]:
    """Writes reconstruction.json and tracks.csv of version 2.

    Returns: sentences about what the format cannot represent.
    """
    written = in_pixels(block, holds)
    foreign = written.foreign
    images, rays = foreign.images, foreign.rays
    turned, translation = rotations.to_camera(images.rotation, images.centre)
    vectors = rotations.to_vectors(turned).tolist()
    shots = {
        name: {"rotation": vectors[k], "translation": translation[k].tolist(), "camera": foreign.cameras[c].name}
        for k, (name, c) in enumerate(zip(images.names, images.camera.tolist(), strict=True))
    }
    points = {
        name: {"coordinates": xyz, "color": list(GREY)}
        for name, xyz in zip(foreign.points.names, foreign.points.coordinates.tolist(), strict=True)
    }
    cameras = {camera.name: _camera(camera) for camera in foreign.cameras}
    path.mkdir(parents=True, exist_ok=True)
    content = [{"cameras": cameras, "shots": shots, "points": points}]
    (path / FILE).write_text(json.dumps(content, indent=1), encoding="utf-8")
    sizes = np.array([(camera.width, camera.height) for camera in foreign.cameras], float)[images.camera[rays.image]]
    xy = ((rays.xy - sizes / 2) / sizes.max(1, keepdims=True)).tolist()
    colour = "\t".join(map(str, GREY))
    with (path / TRACKS).open("w", encoding="utf-8") as file:
        file.write(f"{VERSION}v2\n")
        for k, (i, p, (x, y)) in enumerate(zip(rays.image.tolist(), rays.point.tolist(), xy, strict=True)):
            file.write(
                f"{images.names[i]}\t{foreign.points.names[p]}\t{k}\t{x:.17g}\t{y:.17g}\t{SCALE}\t{colour}\t-1\t-1\n"
            )
    return [*written.losses, *losses_of_block(block, HOLDS)]


def _camera(camera: ForeignCamera) -> dict[str, float | str | int]:
    width, height = camera.width or 1, camera.height or 1
    size, f = max(width, height), element(camera, "principal_distance")
    return {
        "projection_type": "brown",
        "width": width,
        "height": height,
        "focal_x": (f + element(camera, "b1")) / size,
        "focal_y": f / size,
        "c_x": (element(camera, "x0") - width / 2) / size,
        "c_y": (element(camera, "y0") - height / 2) / size,
        **{theirs: element(camera, ours) for theirs, ours in (RADIAL | TANGENTIAL).items()},
    }
