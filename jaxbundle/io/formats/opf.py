"""Reading OPF projects of Pix4D: JSON files, and tracks as glTF. OPF has the same conventions as this package.

Angles are omega, phi, kappa of object_from_image, image coordinates count from the corner; radial and tangential
terms are those of OpenCV: P1 = t2, P2 = t1. The processing frame is canonical = swap(scale base) + shift; the block is
read in the base system, by shift and scale. Tracks have y up in glTF; they are rotated back. Source: Pix4D, OPF
specification 1.0.
"""

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.foreign_block import (
    DEFAULT,
    Distance,
    ForeignBlock,
    ForeignCamera,
    Images,
    Known,
    Points,
    RayTable,
    ReadOptions,
)
from jaxbundle.io.formats.gltf import Tracks, read_tracks
from jaxbundle.io.formats.source import json_of, validated, wrong
from jaxbundle.io.noted import Noted
from jaxbundle.io.text_files import UnreadableError, file_bytes

PROJECT = "project.opf"
HEAD = 4000  # bytes that contain the format of a project
PREFIX, SUFFIX = "application/opf-", "+json"
MARK_SIGMA = 1.0  # px, for a mark without accuracy


class _Loose(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)


Triple = tuple[float, float, float]
Pair = tuple[float, float]


class _Resource(_Loose):
    uri: str
    format: str


class _Item(_Loose):
    type: str
    resources: list[_Resource]


class _Project(_Loose):
    name: str = ""
    items: list[_Item]


class _Named(_Loose):
    id: int
    uri: str


class _CameraList(_Loose):
    cameras: list[_Named]


class _Internals(_Loose):
    type: str
    principal_point_px: Pair
    focal_length_px: float | None = None
    radial_distortion: Triple | None = None
    tangential_distortion: Pair | None = None


class _Sensor(_Loose):
    id: int
    internals: _Internals
    name: str = ""
    image_size_px: Pair | None = None


class _Camera(_Loose):
    id: int
    sensor_id: int
    position: Triple
    orientation_deg: Triple


class _Calibrated(_Loose):
    sensors: list[_Sensor]
    cameras: list[_Camera]


class _Inputs(_Loose):
    sensors: list[_Sensor]


class _Crs(_Loose):
    definition: str = ""


class _Geolocation(_Loose):
    crs: _Crs = _Crs()
    coordinates: Triple
    sigmas: Triple


class _Mark(_Loose):
    camera_id: int
    position_px: Pair
    accuracy: float = MARK_SIGMA


class _Gcp(_Loose):
    id: str
    geolocation: _Geolocation
    marks: list[_Mark] = []
    is_checkpoint: bool = False


class _Mtp(_Loose):
    id: str
    marks: list[_Mark] = []


class _Control(_Loose):
    gcps: list[_Gcp] = []
    mtps: list[_Mtp] = []


class _Scale(_Loose):
    id_from: str
    id_to: str
    distance: float
    sigma: float


class _Constraints(_Loose):
    scale_constraints: list[_Scale] = []


class _Base(_Loose):
    shift: Triple
    scale: Triple
    swap_xy: bool = False


class _Frame(_Loose):
    crs: _Crs = _Crs()
    base_to_canonical: _Base


def _file(path: Path) -> Path | None:
    """The project file of a path of an OPF project."""
    if path.is_dir():
        return path / PROJECT if (path / PROJECT).is_file() else None
    try:
        return path if b"opf-project+json" in file_bytes(path, HEAD) else None
    except UnreadableError:
        return None


def is_opf(path: Path) -> bool:
    """Whether a path is an OPF project or the folder of one."""
    return _file(path) is not None


def read_opf(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the calibrated cameras, tracks and control of a project.

    Raises: BlockError with all problems.
    """
    file = _file(path) or path
    project = validated(file, _Project, json_of(file))
    resources: dict[str, list[Path]] = {}
    for item in project.items:
        for one in item.resources:
            if ".." not in Path(one.uri).parts and not Path(one.uri).is_absolute():
                resources.setdefault(one.format, []).append(file.parent / one.uri)
    calibrated = _resource(resources, "calibrated-cameras", _Calibrated)
    listed = _resource(resources, "camera-list", _CameraList)
    if calibrated is None or listed is None:
        what = f"{file.name} has no {'calibrated cameras' if calibrated is None else 'list of cameras'}"
        raise BlockError([Problem(what, "calibrate the project, and export it again")])
    frame = _resource(resources, "scene-reference-frame", _Frame)
    base = _Base(shift=(0, 0, 0), scale=(1, 1, 1)) if frame is None else frame.base_to_canonical
    _require_plain(file, base)
    inputs = _resource(resources, "input-cameras", _Inputs)
    control = _resource(resources, "input-control-points", _Control) or _Control()
    constraints = _resource(resources, "constraints", _Constraints) or _Constraints()
    cameras, position = _cameras(file, calibrated, inputs)
    names = {one.id: one.uri for one in listed.cameras}
    ids = {one.id: k for k, one in enumerate(calibrated.cameras)}
    shift = np.array(base.shift)
    images = Images(
        tuple(names.get(one.id, str(one.id)) for one in calibrated.cameras),
        np.array([position[one.sensor_id] for one in calibrated.cameras], np.int64),
        rotations.from_angles(np.radians([one.orientation_deg for one in calibrated.cameras]).reshape(-1, 3)),
        np.array([one.position for one in calibrated.cameras]).reshape(-1, 3) - shift,
    )
    tracks = _tracks(resources, ids)
    return _block(file, project.name, (cameras, images, tracks), (control, constraints, shift, ids), frame)


def _block(file: Path, name: str, parts: tuple, known: tuple, frame: _Frame | None) -> ForeignBlock:
    cameras, images, tracks = parts
    control, constraints, shift, ids = known
    marked = [*control.gcps, *control.mtps]
    first = len(tracks.points)
    rows = [
        (ids[mark.camera_id], first + k, *mark.position_px, mark.accuracy)
        for k, point in enumerate(marked)
        for mark in point.marks
        if mark.camera_id in ids and mark.accuracy > 0
    ]
    added = np.array(rows, float).reshape(-1, 5)
    coordinates = np.concatenate([tracks.points - shift, np.full((len(marked), 3), np.nan)])
    findings = ()
    if tracks.lost:
        what = f"{tracks.lost} rays of the tracks are on cameras that are not calibrated"
        findings = (Finding(Kind.UNUSED, what, grade=Severity.NOTE),)
    return ForeignBlock(
        format="OPF project",
        name=name or file.parent.resolve().name,
        cameras=cameras,
        images=images,
        points=Points((*(f"track {k}" for k in range(first)), *(point.id for point in marked)), coordinates),
        rays=RayTable(
            np.r_[tracks.image, added[:, 0].astype(np.int64)],
            np.r_[tracks.point, added[:, 1].astype(np.int64)],
            np.concatenate([tracks.xy, added[:, 2:4]]),
            np.r_[np.full(len(tracks.image), 1.0), added[:, 4]],
        ),
        control=tuple(
            Known(one.id, one.geolocation.coordinates, one.geolocation.sigmas, one.is_checkpoint)
            for one in control.gcps
        ),
        distances=tuple(
            Distance(one.id_from, one.id_to, one.distance, one.sigma)
            for one in constraints.scale_constraints
            if one.distance > 0 and one.sigma > 0
        ),
        coordinate_system="" if frame is None else frame.crs.definition,
        assumptions=("image coordinates of tracks have a standard deviation of 1 px",),
        findings=findings,
    )


def _resource(resources: dict[str, list[Path]], name: str, model: type[BaseModel]) -> Any:
    """The first resource of a kind; None where the project has none."""
    files = resources.get(f"{PREFIX}{name}{SUFFIX}")
    return validated(files[0], model, json_of(files[0])) if files else None


def _require_plain(file: Path, base: _Base) -> None:
    """Raises BlockError for a processing frame that is scaled or left-handed."""
    if base.swap_xy or tuple(base.scale) != (1.0, 1.0, 1.0):
        what = "the processing frame is scaled, or its axes are exchanged (feet, or a left-handed system)"
        raise wrong(file, 0, what, "export the project in a right-handed metric system")


def _cameras(
    file: Path, calibrated: _Calibrated, inputs: _Inputs | None
) -> tuple[tuple[ForeignCamera, ...], dict[int, int]]:
    """Cameras, and the index of each by the id of its sensor."""
    noted, cameras, position = Noted(), [], {}
    given = {one.id: one for one in inputs.sensors} if inputs else {}
    for sensor in calibrated.sensors:
        about = given.get(sensor.id)
        size = about.image_size_px if about else None
        name = f"{about.name if about and about.name else 'sensor'}"
        name = name if name not in {camera.name for camera in cameras} else f"{name} ({sensor.id})"
        inside = sensor.internals
        if inside.type != "perspective" or inside.focal_length_px is None:
            what = f"sensor {sensor.id} has internals of the type {shown(inside.type)}"
            noted.add(file.name, 0, what, "read is perspective; undistort the images")
            continue
        position[sensor.id] = len(cameras)
        elements = _elements(inside)
        estimate = (
            "principal_distance",
            "x0",
            "y0",
            *(key for key, value in elements.items() if key[0] in "KP" and value),
        )
        width, height = (int(side) for side in size) if size and min(size) >= 1 else (None, None)
        cameras.append(ForeignCamera(name, METASHAPE, elements, estimate, "px", width, height))
    missing = {one.sensor_id for one in calibrated.cameras} - {sensor.id for sensor in calibrated.sensors}
    if missing:
        noted.add(file.name, 0, f"sensor {min(missing)} of a camera is not in the calibration", "export it again")
    if noted:
        raise noted.error()
    return tuple(cameras), position


def _elements(inside: _Internals) -> dict[str, float]:
    x0, y0 = inside.principal_point_px
    f = inside.focal_length_px or 0.0
    k1, k2, k3 = inside.radial_distortion or (0.0, 0.0, 0.0)
    t1, t2 = inside.tangential_distortion or (0.0, 0.0)
    return {"principal_distance": f, "x0": x0, "y0": y0, "K1": k1, "K2": k2, "K3": k3, "P1": t2, "P2": t1}


def _tracks(resources: dict[str, list[Path]], ids: dict[int, int]) -> Tracks:
    files = resources.get("model/gltf+json", [])
    for file in files:
        found = read_tracks(file, ids)
        if found is not None:
            return found
    return Tracks(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), 0)
