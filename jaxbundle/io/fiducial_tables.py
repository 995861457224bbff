"""fiducials.csv and fiducial_rays.csv: the inner orientation of scanned film, which transforms rays to mm."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.problems import shown
from jaxbundle.camera.fiducials import PARAMETERS, FiducialError, InnerOrientation, inner_orientation, transformed
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.folder_tables import FIDUCIAL_TABLES, FolderTables, ImageRows, RayRows
from jaxbundle.io.noted import Noted
from jaxbundle.io.settings import CameraSection
from jaxbundle.io.tables import Table

Coordinates = Float[np.ndarray, "2"]


@dataclass(frozen=True)
class _Measured:
    """Fiducials measured on the images, px, and calibrated, mm; rows of the table that can be used."""

    table: Table
    row: Int[np.ndarray, " row"]
    image: Int[np.ndarray, " row"]
    scan: Float[np.ndarray, "row 2"]
    calibrated: Float[np.ndarray, "row 2"]


def with_inner_orientations(tables: FolderTables, toml: BlockToml, noted: Noted) -> FolderTables:
    """The tables with the rays of scanned film in mm, and the fits; problems of fiducials are noted."""
    transformations = _transformations(toml)
    missing = [kind for kind in FIDUCIAL_TABLES if kind not in toml.tables]
    for camera in transformations if missing else ():
        what = f"[cameras.{camera}] fiducials need the table {' and the table '.join(missing)}"
        noted.add(FILE, toml.line("cameras", camera, "fiducials"), what, "name it in [tables], or drop fiducials")
    if tables.fiducials is None or tables.fiducial_rays is None:
        return tables
    calibrated = _calibrated(tables.fiducials, toml)
    measured = _measured(tables.fiducial_rays, tables.fiducials.file, tables.images, toml, calibrated)
    fits = _fits(measured, tables.images, transformations, noted)
    if toml.settings is None or not fits:
        return tables
    rays = _rays_in_mm(tables.rays, fits, tables.images, toml.settings.cameras)
    return dataclasses.replace(tables, rays=rays, inner_orientations=tuple(fits.values()))


def _transformations(toml: BlockToml) -> dict[str, str]:
    """The transformation of each camera that has one, even if block.toml has other problems."""
    return {name: kind for name, kind in _sections_with_fiducials(toml).items() if kind in PARAMETERS}


def _sections_with_fiducials(toml: BlockToml) -> dict[str, str]:
    """The key `fiducials` of each camera that has it."""
    cameras = toml.raw.get("cameras")
    sections = cameras.items() if isinstance(cameras, dict) else ()
    named = ((name, section.get("fiducials")) for name, section in sections if isinstance(section, dict))
    return {name: kind for name, kind in named if isinstance(kind, str)}


def _calibrated(table: Table, toml: BlockToml) -> dict[tuple[str, str], Coordinates]:
    """Calibrated coordinates of each camera and fiducial."""
    fiducials, cameras = table.names("fiducial"), table.text["camera"].to_list()
    known, with_fiducials = toml.camera_names, _sections_with_fiducials(toml)
    if known is not None:
        table.positions("camera", known, FILE)
        for camera in (name for name in dict.fromkeys(cameras) if name in known and name not in with_fiducials):
            what = f"camera {camera} has no fiducials in {FILE}"
            table.note(cameras.index(camera), what, 'give it fiducials = "affine" there, or drop its rows')
    table.unique("camera", "fiducial")
    coordinates = table.numbers("x", "y")
    return dict(zip(zip(cameras, fiducials.to_list(), strict=True), coordinates, strict=True))


def _measured(
    table: Table,
    calibrated_file: str,
    images: ImageRows,
    toml: BlockToml,
    calibrated: dict[tuple[str, str], Coordinates],
) -> _Measured:
    """The rows of fiducial_rays.csv that can be used; the others are noted."""
    image = table.positions("image", images.names, images.table.file)
    fiducials = table.names("fiducial").to_list()
    table.unique("image", "fiducial")
    scan = table.numbers("x", "y")
    target = np.full_like(scan, np.nan)
    missing: dict[tuple[str, str], list[int]] = {}
    for row in np.flatnonzero(image >= 0).tolist():
        camera, fiducial = images.camera[image[row]], fiducials[row]
        if (camera, fiducial) in calibrated:
            target[row] = calibrated[camera, fiducial]
        elif fiducial and camera in (toml.camera_names or ()):
            missing.setdefault((camera, fiducial), []).append(row)
    for (camera, fiducial), rows in missing.items():
        what = f"camera {camera} has no fiducial {shown(fiducial)} in {calibrated_file}"
        table.note(rows, what, "add it there, correct the name or drop the row")
    rows = np.flatnonzero(np.isfinite(scan).all(1) & np.isfinite(target).all(1))
    return _Measured(table, rows, image[rows], scan[rows], target[rows])


def _fits(
    measured: _Measured, images: ImageRows, transformations: dict[str, str], noted: Noted
) -> dict[int, InnerOrientation]:
    """The inner orientation of each image whose camera has fiducials; images without a determined one are noted.

    Images, cameras and fiducials that occur in wrong rows are not reported: that would follow from those rows.
    """
    fits = {}
    order = np.argsort(measured.image, kind="stable")
    ends = np.searchsorted(measured.image[order], np.arange(len(images.names) + 1))
    fiducials = measured.table.text["fiducial"].to_list()
    for i, (image, camera) in enumerate(zip(images.names, images.camera, strict=True)):
        if camera not in transformations:
            continue
        members = order[ends[i] : ends[i + 1]]
        names = tuple(fiducials[row] for row in measured.row[members])
        try:
            fits[i] = inner_orientation(
                image, transformations[camera], names, measured.scan[members], measured.calibrated[members]
            )
        except FiducialError as error:
            if noted.touched.isdisjoint((image, camera)):
                table, row = (measured.table, measured.row[members[0]]) if len(members) else (images.table, i)
                noted.add(table.file, int(table.lines[row]), error.what, error.cure, [image])
    return fits


def _rays_in_mm(
    rays: RayRows, fits: dict[int, InnerOrientation], images: ImageRows, cameras: dict[str, CameraSection]
) -> RayRows:
    """All rays; those on scanned film in the system of the fiducials, their sigmas converted by the nominal pixel."""
    matrices, pixel = np.tile(np.eye(3), (len(images.names), 1, 1)), np.ones(len(images.names))
    for image, fit in fits.items():
        matrices[image], pixel[image] = fit.matrix, cameras[images.camera[image]].pixel_size
    coordinates = transformed(matrices[rays.image], rays.coordinates)
    return dataclasses.replace(rays, coordinates=coordinates, sigmas=rays.sigmas * pixel[rays.image, None])
