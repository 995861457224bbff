"""Reading COLMAP models: cameras, images, points3D and, since 3.12, rigs and frames, as text or binary.

Image coordinates have their origin in the corner of the image. Quaternions and translations are image from object.
Poses of images that belong to frames follow from rig and frame where they differ (COLMAP 4.2 writes stale ones).
The formats are described in COLMAP's documentation, "Output format".
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.findings import Finding, Kind
from jaxbundle.block.problems import shown
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.colmap_binary import read_binary
from jaxbundle.io.formats.colmap_cameras import BY_NAME, BY_NUMBER, READ, camera_from_colmap
from jaxbundle.io.formats.colmap_records import Model
from jaxbundle.io.formats.colmap_text import read_text_model
from jaxbundle.io.formats.foreign_block import (
    DEFAULT,
    ForeignBlock,
    ForeignCamera,
    Images,
    Points,
    RayTable,
    ReadOptions,
)
from jaxbundle.io.noted import Noted

FILES = ("cameras", "images", "points3D")
SPARSE = 4  # point numbers per point and ray: above this, a table of all numbers would be mostly empty
SAME_POSE = 1e-6  # tolerance of quaternions and relative tolerance of translations: rounding of text with few digits


def is_colmap(path: Path) -> bool:
    """Whether a folder contains the three files of a model, as text or binary."""
    return path.is_dir() and any(all((path / f"{name}.{end}").is_file() for name in FILES) for end in ("bin", "txt"))


def read_colmap(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the model in a folder; binary files are preferred to text.

    Raises: BlockError with all problems, each with file and line or byte.
    """
    noted = Noted()
    binary = all((path / f"{name}.bin").is_file() for name in FILES)
    model = read_binary(path, noted) if binary else read_text_model(path, noted)
    cameras = _cameras(path, model, noted, "bin" if binary else "txt")
    if noted:
        raise noted.error()
    rotation, translation, findings = _poses(model)
    matrices = rotations.from_quaternions(rotation)
    turned, centre = rotations.from_camera(matrices, translation)
    rays = _rays(model)
    return ForeignBlock(
        format=f"COLMAP model ({'binary' if binary else 'text'})",
        name=path.resolve().name,
        cameras=tuple(cameras.values()),
        images=Images(model.image_names, _positions(list(cameras), model.image_camera), turned, centre),
        points=Points(tuple(map(str, model.point_ids.tolist())), model.coordinates),
        rays=rays.rays,
        arbitrary=True,
        assumptions=("image coordinates have a standard deviation of 1 px",),
        findings=(*findings, *rays.findings),
    )


def _positions(ids: list[int], wanted: Int[np.ndarray, " image"]) -> Int[np.ndarray, " image"]:
    position = {number: k for k, number in enumerate(ids)}
    return np.array([position[number] for number in wanted.tolist()], np.int64)


def _cameras(path: Path, model: Model, noted: Noted, end: str) -> dict[int, ForeignCamera]:
    """Cameras by their number; problems are noted."""
    cameras, file = {}, f"cameras.{end}"
    for row in model.cameras:
        known = BY_NAME.get(row.model) if isinstance(row.model, str) else BY_NUMBER.get(row.model)
        cure = f"read are {READ}; undistort the images in COLMAP and take the model that it writes then"
        if known is None or known.model is None:
            noted.add(file, row.line, f"camera {row.id} has the model {known.name if known else row.model}", cure)
        elif len(known.parameters) != len(row.parameters):
            what = f"camera {row.id} has {len(row.parameters)} parameters, {known.name} has {len(known.parameters)}"
            noted.add(file, row.line, what, "correct it, or export it again")
        elif row.id in cameras:
            noted.add(file, row.line, f"there are two cameras {row.id}", "export the model again")
        else:
            cameras[row.id] = camera_from_colmap(str(row.id), known, row.width, row.height, list(row.parameters))
    given = {row.id for row in model.cameras}
    for name, camera in zip(model.image_names, model.image_camera.tolist(), strict=True):
        if camera not in given:
            noted.add(
                f"images.{end}",
                0,
                f"image {shown(name)} has the camera {camera}, which is not in {file}",
                "add the camera",
            )
    return cameras


class _Rays(NamedTuple):
    rays: RayTable
    findings: tuple[Finding, ...]


def _rays(model: Model) -> _Rays:
    """The rays whose points exist."""
    place = _places(model.point_ids, model.ray_point)
    known = place >= 0
    image, point, xy = model.ray_image[known], place[known], model.xy[known]
    findings = ()
    if not known.all():
        what = f"{int((~known).sum())} image points name a point that is not in points3D and are not used"
        findings = (Finding(Kind.UNUSED, what),)
    return _Rays(RayTable(image, point, xy), findings)


def _places(ids: Int[np.ndarray, " point"], wanted: Int[np.ndarray, " ray"]) -> Int[np.ndarray, " ray"]:
    """Indices of numbers among others, -1 for a missing one; with a lookup table unless the numbers are sparse."""
    if not len(ids):
        return np.full(len(wanted), -1)
    if ids.max() < SPARSE * (len(ids) + len(wanted)):
        table = np.full(ids.max() + 2, -1)
        table[ids] = np.arange(len(ids))
        return table[np.minimum(wanted, ids.max() + 1)]
    order = np.argsort(ids, kind="stable")
    place = order[np.minimum(np.searchsorted(ids, wanted, sorter=order), len(ids) - 1)]
    return np.where(ids[place] == wanted, place, -1)


def _poses(
    model: Model,
) -> tuple[Float[np.ndarray, "image 4"], Float[np.ndarray, "image 3"], tuple[Finding, ...]]:
    """Quaternions and translations, from rigs and frames where these differ from the images."""
    quaternion, translation = model.quaternion.copy(), model.translation.copy()
    position = {number: k for k, number in enumerate(model.image_ids.tolist())}
    sensors = {(rig, sensor.key): sensor.pose for rig, row in model.rigs.items() for sensor in row}
    changed = 0
    for frame in model.frames:
        for key, data in frame.data:
            pose = sensors.get((frame.rig, key))
            if data not in position or pose is None or key[0] != 0:
                continue
            composed = _composed(pose, frame.pose)
            k = position[data]
            own = np.r_[quaternion[k], translation[k]]
            if _differ(composed, own):
                changed += 1
                quaternion[k], translation[k] = composed[:4], composed[4:]
    if not changed:
        return quaternion, translation, ()
    what = f"the poses of {changed} images differ from the poses of their rigs and frames, which are used"
    return quaternion, translation, (Finding(Kind.INFORMATION, what),)


def _differ(one: Float[np.ndarray, "7"], other: Float[np.ndarray, "7"]) -> bool:
    """Whether two poses differ; a quaternion and its negative are the same."""
    a, b = one[:4] / np.linalg.norm(one[:4]), other[:4] / (np.linalg.norm(other[:4]) or 1.0)
    size = max(np.abs(one[4:]).max(), 1.0)
    return bool(1 - abs(a @ b) > SAME_POSE or np.abs(one[4:] - other[4:]).max() > SAME_POSE * size)


def _composed(sensor: Float[np.ndarray, "7"], rig: Float[np.ndarray, "7"]) -> Float[np.ndarray, "7"]:
    """The pose image from object: rig_from_object, then sensor_from_rig."""
    turn = rotations.from_quaternions(sensor[None, :4])[0]
    a, (b0, b1, b2, b3) = sensor[:4], rig[:4]
    left = np.array([[b0, -b1, -b2, -b3], [b1, b0, b3, -b2], [b2, -b3, b0, b1], [b3, b2, -b1, b0]])
    return np.r_[left @ a, turn @ rig[4:] + sensor[4:]]
