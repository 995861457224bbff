"""A result as a recording of Rerun, a viewer of images and points in space (package rerun-sdk).

    points          object points, coloured by the logarithm of their standard deviation in Z; control and check points
    images/NAME     the image as a pinhole, with the residuals of its rays as arrows
    iterations      v^T P v, damping and step over the iterations

Rerun has coordinates in single precision: all are reduced by an offset, which the name of the recording contains.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.io.formats.extras import extra
from jaxbundle.io.results.clouds import COLOURS, offset_of
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.html.raster import viridis
from jaxbundle.report.pictures.known import known, nice
from jaxbundle.report.pictures.plan_picture import TIE, plan
from jaxbundle.report.pictures.ray_pictures import image_format
from jaxbundle.report.point_cloud import format_corners
from jaxbundle.solve.adjustment import Adjustment

CAMERA_AXES = np.diag([1.0, -1.0, -1.0])  # Rerun's pinholes look along z, with y down
ARROW = 0.02  # share of the format: length of the median residual as an arrow
INTO = 0.08  # ratio of the distance of the picture of an image from its centre and the distance to the points


def to_rerun(result: Adjustment, path: str | Path) -> Path:
    """Writes a result as a recording for the viewer Rerun, and returns its path.

    A recording depends on the version of Rerun; `to_ply` writes a permanent format.

    Raises: TypeError for other objects; BlockError where rerun-sdk is not installed; OSError where the file
    cannot be written.

    Example:
        >>> jb.report.to_rerun(result, "block.rrd").name
        'block.rrd'
    """
    require_a(Adjustment, result, "report.to_rerun")
    require_photographs(result.block, "report.to_rerun")
    rerun, target = extra("rerun", "to_rerun"), Path(path)
    with target.open("wb"):
        pass  # Rerun reports no error if it cannot write
    with np.errstate(all="ignore"):
        figures = figures_of(result, ())
    offset = offset_of(figures.points)
    name = figures.structure.name or "block"
    recording = rerun.RecordingStream(f"{name}, less {offset[0]:.0f} {offset[1]:.0f} {offset[2]:.0f}")
    recording.save(str(target))
    _points(rerun, recording, figures, offset)
    _images(rerun, recording, figures, offset)
    _iterations(rerun, recording, result)
    recording.flush()
    recording.disconnect()
    return target


def _points(rerun: Any, recording: Any, figures: Figures, offset: np.ndarray) -> None:
    seen, names = plan(figures), figures.structure.point_names
    usable = np.isfinite(seen.points).all(1)
    sd = figures.points_sd[:, 2]
    good = sd[np.isfinite(sd) & (sd > 0)]
    low, high = np.quantile(good, [0.02, 0.98]) if len(good) else (1.0, 1.0)
    with np.errstate(all="ignore"):
        share = np.log(sd / low) / np.log(max(high, 1.05 * low) / low)
    ties = usable & (seen.role == TIE)
    colours = viridis(share[ties]) if len(good) else np.array([COLOURS[TIE]])
    recording.log("points/tie", rerun.Points3D(seen.points[ties] - offset, colors=colours), static=True)
    for role, kind in ((1, "control"), (2, "check")):
        rows = np.flatnonzero(usable & (seen.role == role))
        if len(rows):
            labels = [names[k] for k in rows]
            marks = rerun.Points3D(seen.points[rows] - offset, colors=[COLOURS[role]], labels=labels)
            recording.log(f"points/{kind}", marks, static=True)


def _images(rerun: Any, recording: Any, figures: Figures, offset: np.ndarray) -> None:
    structure, block = figures.structure, figures.adjustment.block
    rotation = np.asarray(unknowns_of(block).rotation).T.reshape(-1, 3, 3) @ CAMERA_AXES
    centres = known(figures.exterior[:, :3])
    depth = INTO * float(np.linalg.norm(np.nanmean(known(figures.points), 0) - np.nanmean(centres, 0)))
    xy, v = np.asarray(block.rays.coordinates), known(figures.residuals[0])
    for k in np.flatnonzero(np.isfinite(centres).all(1)).tolist():
        camera = int(structure.image_camera[k])
        left, low, right, high = image_format(figures, camera)
        down = structure.cameras[camera].image_unit == "px"
        size, corners = np.array([right - left, high - low]), format_corners(figures, camera)
        focal = size / np.abs(corners[2, :2] - corners[0, :2])
        principal = np.array([-corners[0, 0], corners[0 if down else 3, 1]]) * focal
        entity = ["images", structure.image_names[k]]
        pose = rerun.Transform3D(translation=centres[k] - offset, mat3x3=rotation[k])
        lens = rerun.Pinhole(resolution=size, focal_length=focal, principal_point=principal, image_plane_distance=depth)
        recording.log(entity, pose, lens, static=True)
        mine = np.flatnonzero((structure.ray_image == k) & np.isfinite(v).all(1))
        if not len(mine):
            continue
        at = xy[mine] - [left, low]
        at[:, 1] = at[:, 1] if down else size[1] - at[:, 1]
        arrows = v[mine] * [1.0, -1.0]  # residuals point up, pictures of Rerun down
        median = float(np.median(np.hypot(*arrows.T)))
        factor = nice(ARROW * float(size.max()) / median) if median > 0 else 1.0
        recording.log(
            [*entity, f"residuals x {factor:g}"], rerun.Arrows2D(origins=at, vectors=factor * arrows), static=True
        )


def _iterations(rerun: Any, recording: Any, result: Adjustment) -> None:
    history = result.iterations.history
    columns = {"vTPv": 2 * np.asarray(history.cost), "damping": history.damping, "step": history.step}
    for row in np.flatnonzero(~np.isnan(np.asarray(history.damping))).tolist():
        recording.set_time("iteration", sequence=row + 1)
        for name, values in columns.items():
            recording.log(f"iterations/{name}", rerun.Scalars([float(np.asarray(values)[row])]))
