"""Reading Metashape projects (.psx, .psz), their doc.xml, and the XML of exported cameras and markers.

    X0 = s R c + t,  R_jb = R R_cam D         chunk transform (R, t, s); 4x4 matrix chunk_from_camera of a camera
    u = W/2 + cx + f x' + b1 x' + b2 y'       the camera model `metashape`; cx, cy from the image centre

Old files have fx, fy, skew and absolute cx, cy. With a geographic or projected reference the chunk transform gives
geocentric coordinates. They are not changed; control is transformed to them. Tie points are read from .psz (point_cloud
of PLY files). Source: Agisoft Metashape user manual, appendix "Camera models"; the elements are those of projects of
versions 1.2 to 1.5.
"""

import math
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import shown
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.camera.lenses import FISHEYE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.coordinates import is_geocentric, is_metric_local, transformed
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
from jaxbundle.io.formats.metashape_archive import Archive
from jaxbundle.io.formats.ply_files import ply_vertices
from jaxbundle.io.formats.source import XmlNumbers, child_text, wrong
from jaxbundle.io.noted import Noted
from jaxbundle.io.text_files import UnreadableError, file_bytes

TERMS = {"k1": "K1", "k2": "K2", "k3": "K3", "k4": "K4", "p1": "P1", "p2": "P2", "b1": "b1", "b2": "b2"}
SETTINGS = {
    "accuracy_markers": 0.005,
    "accuracy_projections": 0.1,
    "accuracy_tiepoints": 1.0,
    "accuracy_scalebars": 0.001,
}
HEAD = 3000  # bytes that contain the root and a chunk


def is_metashape(path: Path) -> bool:
    """Whether a path is a project of Metashape, its unpacked folder, or an XML export with a chunk."""
    if path.is_dir():
        return (path / "doc.xml").is_file() and _has_chunk(path / "doc.xml")
    if path.suffix.lower() in (".psx", ".psz"):
        return path.is_file()
    return _has_chunk(path)


def _has_chunk(path: Path) -> bool:
    try:
        head = file_bytes(path, HEAD)
    except UnreadableError:
        return False
    return (b"<document" in head or b"<chunk" in head) and (b"<chunk" in head or b"sensors" in head)


class _Transform(NamedTuple):
    """The similarity X = scale R x + t."""

    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]
    scale: float

    def __call__(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
        return self.scale * points @ self.rotation.T + self.translation


def read_metashape(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the first chunk of a project, or the one with a label.

    Raises: BlockError with all problems.
    """
    archive = Archive(path)
    root = archive.document()
    chunk, findings = _chunk(path, root, options.chunk)
    reader = _Reader(path, archive, chunk)
    return reader.block(findings)


def _chunk(path: Path, root: ElementTree.Element, label: str) -> tuple[ElementTree.Element, tuple[Finding, ...]]:
    chunks = [root] if root.tag == "chunk" else root.findall(".//chunk")
    labels = [chunk.get("label", "") for chunk in chunks]
    if label and label not in labels:
        raise wrong(path, 0, f"there is no chunk '{shown(label)}'", f"there are {', '.join(map(shown, labels))}")
    if not chunks:
        raise wrong(path, 0, "there is no chunk", "give a project or an export of cameras")
    if label or len(chunks) == 1:
        return chunks[labels.index(label) if label else 0], ()
    what = f"the project has {len(chunks)} chunks; {shown(labels[0])} was read"
    return chunks[0], (Finding(Kind.UNUSED, what, "choose another one with --chunk", grade=Severity.CHECK),)


class _Reader:
    """Content of one chunk."""

    def __init__(self, path: Path, archive: Archive, chunk: ElementTree.Element):
        self.path, self.archive, self.chunk, self.noted = path, archive, chunk, Noted()
        self.numbers = XmlNumbers(path, self.noted)
        self.settings = dict(SETTINGS)
        for one in chunk.findall("settings/property"):
            if one.get("name") in SETTINGS:
                value = self.numbers.attribute(one, "value", "settings")
                self.settings[one.get("name", "")] = value if value > 0 else SETTINGS[one.get("name", "")]
        self.transform = self._transform()
        self.system = child_text(chunk, "reference")

    def _transform(self) -> _Transform:
        rotation, what = np.eye(3), "the transform of the chunk"
        text = child_text(self.chunk, "transform/rotation")
        if text:
            found = self.numbers.array(text, 9, what)
            rotation = rotation if found is None else found.reshape(3, 3)
        text, translation = child_text(self.chunk, "transform/translation"), np.zeros(3)
        if text:
            found = self.numbers.array(text, 3, what)
            translation = translation if found is None else found
        return _Transform(rotation, translation, self.numbers.of(self.chunk, "transform/scale", what, 1.0))

    def block(self, findings: tuple[Finding, ...]) -> ForeignBlock:
        """Makes the block. Raises: BlockError with all noted problems."""
        cameras, number_of_sensor = self._sensors()
        ids, images = self._cameras(number_of_sensor)
        with np.errstate(all="ignore"):  # values that are not finite are reported by that function
            ties, coordinates, rays = self._tie_points(ids)
        control, marks = self._markers(ids, len(ties))
        names = [*ties, *(name for name in marks.names)]
        coordinates = np.concatenate([coordinates, np.full((len(marks.names), 3), np.nan)])
        if not names:
            cure = (
                "Metashape packs the tie points of .psx: save the project as .psz, or export COLMAP or BlocksExchange"
            )
            self.noted.add(self.path.name, 0, "the chunk has neither tie points nor measured markers", cure)
        if self.noted:
            raise self.noted.error()
        rolling = self.chunk.find(".//sensor/property[@name='rolling_shutter']")
        if rolling is not None and rolling.get("value") in ("true", "1", "regularized", "full"):
            what = "a camera has a rolling shutter, which is not modelled"
            findings = (*findings, Finding(Kind.INFORMATION, what, grade=Severity.CHECK))
        table = np.concatenate([rays, marks.rays])
        sigma = np.r_[
            np.full(len(rays), self.settings["accuracy_tiepoints"]),
            np.full(len(marks.rays), self.settings["accuracy_projections"]),
        ]
        return ForeignBlock(
            format="Metashape project",
            name=self.path.resolve().stem if self.path.is_file() else self.path.resolve().name,
            cameras=cameras,
            images=images,
            points=Points(tuple(names), coordinates),
            rays=RayTable(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:], sigma),
            control=self._in_chunk_system(control),
            stations=(),
            distances=self._scale_bars(),
            coordinate_system=self.system,
            assumptions=self._assumptions(),
            findings=findings,
        )

    def _assumptions(self) -> tuple[str, ...]:
        s = self.settings
        ties = f"tie points have a standard deviation of {s['accuracy_tiepoints']:g} px and markers of"
        words = (f"{ties} {s['accuracy_projections']:g} px, from the settings of the chunk",)
        if self._is_geocentric():
            words += ("object coordinates are geocentric (EPSG:4978), as in the chunk",)
        return words

    def _is_geocentric(self) -> bool:
        return bool(self.system) and not is_metric_local(self.system)

    def _in_chunk_system(self, rows: tuple[Known, ...]) -> tuple[Known, ...]:
        """References of a geographic or projected system as geocentric coordinates.

        Sigmas along the axes of a local system are replaced by the minimum of the three.
        """
        if not rows or not self._is_geocentric() or is_geocentric(self.system):
            return rows
        found = transformed(self.system, "EPSG:4978", np.array([row.coordinates for row in rows]))
        return tuple(
            row._replace(coordinates=tuple(place), sigmas=(max(row.sigmas),) * 3)
            for row, place in zip(rows, found.tolist(), strict=True)
        )

    def _sensors(self) -> tuple[tuple[ForeignCamera, ...], dict[str, int]]:
        cameras, position = [], {}
        for sensor in self.chunk.findall("sensors/sensor"):
            number = sensor.get("id", "")
            label, what = sensor.get("label") or f"sensor {number}", f"sensor {number}"
            resolution = sensor.find("resolution")
            width, height = 0.0, 0.0
            if resolution is not None:
                width, height = (self.numbers.attribute(resolution, side, what) for side in ("width", "height"))
            if not (1 <= width < 1e8 and 1 <= height < 1e8):
                self.noted.add(self.path.name, 0, f"{what} has no resolution", "export the cameras again")
                continue
            taken = {camera.name for camera in cameras}
            name = label if label not in taken else f"{label} ({number})"
            position[number] = len(cameras)
            cameras.append(self._camera(sensor, name, what, (int(width), int(height))))
        return tuple(cameras), position

    def _camera(self, sensor: ElementTree.Element, name: str, what: str, size: tuple[int, int]) -> ForeignCamera:
        found = {one.get("class", ""): one for one in sensor.findall("calibration")}
        calibration = found.get("adjusted", found.get("initial", found.get("")))
        kind = "frame" if calibration is None else calibration.get("type", sensor.get("type", "frame"))
        if kind not in ("frame", "fisheye", "equidistant_fisheye"):
            cure = "read are frame and fisheye; convert the cameras in Metashape"
            self.noted.add(self.path.name, 0, f"{what} has the type {shown(kind)}", cure)
        elements = {ours: self.numbers.of(calibration, theirs, what, 0.0) for theirs, ours in TERMS.items()}
        cx, cy = (self.numbers.of(calibration, key, what, math.nan) for key in ("cx", "cy"))
        old = calibration is not None and calibration.find("fx") is not None
        if old:
            fx, fy = (self.numbers.of(calibration, key, what) for key in ("fx", "fy"))
            elements |= {"principal_distance": fy, "b1": fx - fy}
            elements["b2"] = self.numbers.of(calibration, "skew", what, 0.0)
            middle = 0.0, 0.0
        else:
            elements["principal_distance"] = self.numbers.of(calibration, "f", what, self._nominal(sensor, what))
            middle = size[0] / 2, size[1] / 2
            cx, cy = (0.0 if math.isnan(value) else value for value in (cx, cy))
        if not elements["principal_distance"] > 0:
            self.noted.add(self.path.name, 0, f"{what} has no principal distance", "give its calibration")
        elements |= {"x0": middle[0] + cx, "y0": middle[1] + cy}
        fixed = sensor.find("property[@name='fixed']")
        if fixed is not None and fixed.get("value") == "true":
            estimate: tuple[str, ...] = ()
        else:
            estimate = ("principal_distance", "x0", "y0", *(key for key in TERMS.values() if elements[key]))
        model = METASHAPE if kind == "frame" else FISHEYE
        return ForeignCamera(name, model, elements, estimate, "px", *size)

    def _nominal(self, sensor: ElementTree.Element, what: str) -> float:
        """Approximate principal distance in px of a camera that was not calibrated."""
        values = []
        for name in ("focal_length", "pixel_width"):
            one = sensor.find(f"property[@name='{name}']")
            values.append(math.nan if one is None else self.numbers.attribute(one, "value", what))
        return values[0] / values[1] if values[1] else math.nan

    def _cameras(self, number_of_sensor: dict[str, int]) -> tuple[dict[str, int], Images]:
        ids, names, cameras, turns, centres = {}, [], [], [], []
        for one in self.chunk.findall("cameras//camera"):
            number, label = one.get("id", ""), one.get("label") or f"camera {one.get('id')}"
            if one.get("enabled") in ("false", "0"):
                continue
            sensor = number_of_sensor.get(one.get("sensor_id", ""))
            if sensor is None:
                self.noted.add(self.path.name, 0, f"camera {shown(label)} has no sensor", "export the cameras again")
                continue
            text, matrix = child_text(one, "transform"), np.full((4, 4), np.nan)
            if text:
                found = self.numbers.array(text, 16, f"camera {shown(label)}")
                matrix = matrix if found is None else found.reshape(4, 4)
            ids[number] = len(names)
            names.append(label if label not in names else f"{label} ({number})")
            cameras.append(sensor)
            turns.append(self.transform.rotation @ matrix[:3, :3] @ rotations.DOWN_FORWARD)
            centres.append(self.transform(matrix[None, :3, 3])[0])
        return ids, Images(
            tuple(names),
            np.array(cameras, np.int64),
            np.array(turns).reshape(-1, 3, 3),
            np.array(centres).reshape(-1, 3),
        )

    def _tie_points(self, ids: dict[str, int]) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Reads names and coordinates of tie points, and rays (image, point, x, y)."""
        cloud = self.chunk.find(".//point_cloud")
        nothing = [], np.zeros((0, 3)), np.zeros((0, 4))
        file = None if cloud is None else cloud.find("points")
        data = None if file is None else self.archive.read(file.get("path", ""))
        if cloud is None or data is None:
            return nothing
        points = ply_vertices(self.path, data, ("x", "y", "z", "id"))
        numbers = points["id"].astype(np.int64)
        order = np.argsort(numbers)
        places = np.column_stack([points[axis] for axis in "xyz"]).astype(float)
        rays = []
        for one in cloud.findall("projections"):
            image = ids.get(one.get("camera_id", ""))
            data = self.archive.read(one.get("path", ""))
            if image is None or data is None:
                continue
            rows = ply_vertices(self.path, data, ("x", "y", "id"))
            wanted = rows["id"].astype(np.int64)
            at = np.minimum(np.searchsorted(numbers, wanted, sorter=order), max(len(order) - 1, 0))
            point = order[at] if len(order) else at
            known = numbers[point] == wanted if len(order) else np.zeros(len(wanted), bool)
            xy = np.column_stack([rows["x"], rows["y"]]).astype(float)
            rays.append(np.column_stack([np.full(int(known.sum()), image), point[known], xy[known]]))
        table = np.concatenate(rays) if rays else np.zeros((0, 4))
        if not np.isfinite(table).all() or not np.isfinite(places).all():
            raise wrong(self.path, 0, "tie points have coordinates that are not finite", "save the project again")
        return [f"tie {number}" for number in numbers.tolist()], self.transform(places), table

    def _markers(self, ids: dict[str, int], first: int) -> tuple[tuple[Known, ...], "_Marks"]:
        """Reads the references of markers, and their measured rays (image, point, x, y)."""
        known, names, position = [], [], {}
        for one in self.chunk.findall("markers//marker"):
            number, label = one.get("id", ""), one.get("label") or f"marker {one.get('id')}"
            label = label if label not in names else f"{label} ({number})"
            position[number] = len(names)
            names.append(label)
            reference = one.find("reference")
            if reference is not None and reference.get("x") is not None:
                known.append(self._reference(label, reference))
        rays = []
        for one in self.chunk.findall(".//frame/markers/marker") or self.chunk.findall(".//markers/marker[@marker_id]"):
            for place in one.findall("location"):
                x, y = (self.numbers.attribute(place, axis, "a marker") for axis in "xy")
                image, marker = ids.get(place.get("camera_id", "")), position.get(one.get("marker_id", ""))
                measured = place.get("pinned", place.get("valid", "true")) != "false"
                if image is not None and marker is not None and measured and x == x and y == y:
                    rays.append((image, first + marker, x, y))
        return tuple(known), _Marks(tuple(names), np.array(rays, float).reshape(-1, 4))

    def _reference(self, label: str, reference: ElementTree.Element) -> Known:
        what, usual = f"marker {shown(label)}", self.settings["accuracy_markers"]
        place = tuple(self.numbers.attribute(reference, axis, what) for axis in "xyz")
        both = self.numbers.attribute(reference, "sxy", what, math.nan)
        every = self.numbers.attribute(reference, "sxyz", what, math.nan)
        sigmas = []
        for axis in "xyz":
            sigma = self.numbers.attribute(reference, f"s{axis}", what, math.nan)
            others = (both if axis in "xy" else math.nan, every, usual)
            sigmas.append(next(value for value in (sigma, *others) if not math.isnan(value)))
        check = reference.get("enabled") in ("false", "0")
        return Known(label, (place[0], place[1], place[2]), (sigmas[0], sigmas[1], sigmas[2]), check)

    def _scale_bars(self) -> tuple[Distance, ...]:
        labels = {one.get("id"): one.get("label") or "" for one in self.chunk.findall("markers//marker")}
        found = []
        for bar in self.chunk.findall("scalebars//scalebar"):
            ends = [labels.get(end.get("marker_id"), "") for end in bar.findall("endpoint")]
            reference = bar.find("reference")
            if len(ends) != 2 or not all(ends) or reference is None or reference.get("enabled") in ("false", "0"):
                continue
            what = f"scale bar {shown(bar.get('label') or '')}"
            distance = self.numbers.attribute(reference, "distance", what, self.numbers.attribute(reference, "d", what))
            sigma = self.numbers.attribute(reference, "sd", what, self.settings["accuracy_scalebars"])
            if distance > 0 and sigma > 0:
                found.append(Distance(ends[0], ends[1], distance, sigma))
        return tuple(found)


class _Marks(NamedTuple):
    """Adds markers and their rays."""

    names: tuple[str, ...]
    rays: Float[np.ndarray, "ray 4"]
