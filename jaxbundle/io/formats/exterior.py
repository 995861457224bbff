"""Writing a table of exterior elements: image, X, Y, Z, omega, phi, kappa in degrees, camera; and its system.

Programs that make orthophotos read it (orthority, Pix4D, MicMac's OriConvert, Metashape). The angles belong to
R = R_x(omega) R_y(phi) R_z(kappa), object_from_image.
"""

import csv
from pathlib import Path

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.written import foreign_block

HEADER = ("filename", "x", "y", "z", "omega", "phi", "kappa", "camera")


def write_exterior(block: Block, path: Path) -> list[str]:
    """Writes the table as CSV and, where the coordinate system is known, NAME.prj with its text.

    Returns: sentences about what the format cannot represent.
    """
    foreign = foreign_block(block)
    angles = np.degrees(rotations.to_angles(foreign.images.rotation))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for k, name in enumerate(foreign.images.names):
            row = [f"{value:.17g}" for value in (*foreign.images.centre[k], *angles[k])]
            writer.writerow([name, *row, foreign.cameras[foreign.images.camera[k]].name])
    if foreign.coordinate_system:
        path.with_suffix(".prj").write_text(foreign.coordinate_system + "\n", encoding="utf-8")
    return ["everything but the exterior orientations"]
