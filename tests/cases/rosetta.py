"""The Strasbourg block of DBAT as ten programs write it: 5 images, 1166 tie points, 4019 rays, 16 control points."""

import shutil
from pathlib import Path

import numpy as np

from jaxbundle.io.formats.foreign_block import ForeignBlock, ReadOptions
from jaxbundle.io.formats.format_table import read_format
from jaxbundle.io.formats.misfit import ray_residuals

PLACES = {
    "metashape": "metashape/sxb",
    "blocksexchange": "blocksexchange/sxb_blocksexchange.xml",
    "bundler": "bundler/sxb",
    "opf": "opf/sxb",
    "bingo": "bingo",
    "patb": "patb",
    "inpho": "inpho/sxb.prj",
}
PIX4D = ("tp_pix4d", "bingo", "orima")
PIXEL = 0.006  # mm
OPTIONS = ReadOptions((8858, 12996), (20656.5, 4430.0, 6468.0), PIXEL)


def rosetta(shared_data: Path, name: str) -> ForeignBlock:
    """The block from one of the formats."""
    return read_format(shared_data / "exchange" / PLACES[name], name)


def pix4d_folder(shared_data: Path, folder: Path, form: str) -> Path:
    """A params folder with image measurements in one of three forms."""
    folder.mkdir(parents=True)
    for name in ("calibrated_external_camera_parameters", form):
        shutil.copy(shared_data / "exchange" / "pix4d" / f"sxb_{name}.txt", folder)
    return folder


def half_sum_of_squares(foreign: ForeignBlock) -> float:
    """0.5 sum v^2 of all rays whose point has coordinates, unit of the rays."""
    v, _ = ray_residuals(foreign)
    return 0.5 * float(np.nansum(v**2))


def rms_at(foreign: ForeignBlock, coordinates: dict[str, np.ndarray]) -> float:
    """Root mean square per coordinate at given coordinates of points, unit of the rays."""
    nowhere = np.full(3, np.nan)
    points = np.array([coordinates.get(name, nowhere) for name in foreign.points.names])
    v, _ = ray_residuals(foreign, points)
    return float(np.sqrt(np.nanmean(v**2)))
