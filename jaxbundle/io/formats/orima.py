"""Reading ORIMA: rows of image coordinates, and a table of exterior elements in the same folder.

    NAME.txt, NAME.ori    image point x y flag M|A       mm, image centre, y up
    NAME.csv              filename,x,y,z,omega,phi,kappa[,camera]       deg, R_x R_y R_z object_from_image

The rows contain neither orientations nor cameras: these come from the table, --interior F,X0,Y0 in px, --image-size
W,H and --pixel-size. Source: MicMac, which writes and reads such rows.
"""

import csv
import io
import re
from pathlib import Path

import numpy as np

from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.collected import IN_PX, Collected
from jaxbundle.io.formats.exterior import HEADER
from jaxbundle.io.formats.foreign_block import DEFAULT, ForeignBlock, ForeignCamera, ReadOptions
from jaxbundle.io.formats.photo_rows import END
from jaxbundle.io.formats.source import AGAIN, lines_of, numbers
from jaxbundle.io.noted import Noted
from jaxbundle.io.text_files import UnreadableError, file_bytes

HEAD = 400  # bytes that contain the first rows
ROW = re.compile(rb"\s*\S+\s+\S+\s+[+-]?\d+\.?\d*\s+[+-]?\d+\.?\d*\s+\d+\s+[MA]\s*(\r?\n|$)")


def is_orima(path: Path) -> bool:
    """Whether a file begins with a row of ORIMA."""
    try:
        return path.is_file() and bool(ROW.match(file_bytes(path, HEAD)))
    except UnreadableError:
        return False


def read_orima(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the block of rows and their table.

    Raises: BlockError with all problems.
    """
    table = path.with_suffix(".csv")
    if not table.is_file():
        what = f"{path.name} has image coordinates of ORIMA and no orientations"
        raise BlockError([Problem(what, f"add {table.name}: {','.join(HEADER)}")])
    if options.interior is None or options.image_size is None or options.pixel_size is None:
        what = f"{path.name} has image coordinates of ORIMA in mm and no camera"
        raise BlockError([Problem(what, "give --interior F,X0,Y0 in px, --image-size W,H and --pixel-size MM")])
    noted, found = Noted(), Collected()
    _exterior(table, found, noted)
    read_orima_rows(path, found, noted)
    if noted:
        raise noted.error()
    f, x0, y0 = options.interior
    width, height = options.image_size
    rays = found.ray_table()
    xy = np.array([width, height]) / 2 + rays.xy / options.pixel_size * [1, -1]
    elements = {"principal_distance": f, "x0": x0, "y0": y0}
    return ForeignBlock(
        format="ORIMA measurements",
        name=path.resolve().stem,
        cameras=(ForeignCamera("camera", METASHAPE, elements, (), "px", width, height),),
        images=found.images_with(["camera"], lambda rows: rotations.from_angles(np.radians(rows))),
        points=found.points_found(),
        rays=rays._replace(xy=xy),
        assumptions=(IN_PX,),
    )


def read_orima_rows(path: Path, found: Collected, noted: Noted) -> None:
    """Collects the rays of the rows, in mm."""
    for line, text in enumerate(lines_of(path), 1):
        fields = text.split()
        if not fields or fields[0] == END:
            continue
        values = numbers(path, line, fields[2:4], noted) if len(fields) >= 4 else None
        if len(fields) < 4:
            noted.add(path.name, line, f"the row has {len(fields)} fields, not image point x y flag M", AGAIN)
        if values is not None:
            found.ray(fields[0], fields[1], values[0], values[1])


def _exterior(path: Path, found: Collected, noted: Noted) -> None:
    """Collects the orientations of a table of exterior elements."""
    rows = csv.reader(io.StringIO("\n".join(lines_of(path))))
    for line, fields in enumerate(rows, 1):
        if line == 1 or not fields:
            continue
        if len(fields) < 7:
            noted.add(path.name, line, f"the row has {len(fields)} fields, not {','.join(HEADER)}", AGAIN)
            continue
        values = numbers(path, line, fields[1:7], noted)
        if values is not None:
            found.image(fields[0])
            found.orientation[fields[0]] = np.array(values[:3]), np.array(values[3:])
