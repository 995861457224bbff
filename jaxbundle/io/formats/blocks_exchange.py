"""BlocksExchange XML of Bentley, Metashape and DJI Terra. The file is streamed, so large files need little memory.

Image coordinates in px have their origin in the centre of the top left pixel: half a pixel is added. M transforms from
the object system to the camera, with the x and y axes of CameraOrientation; XRightYDown: R_jb = M^T D.
Omega, phi, kappa have M = (R_x R_y R_z)^T for that camera. f in px = FocalLength max(W, H) / SensorSize.
Source: Bentley, iTwin Capture, "Import photos and control points: Blocks exchange XML format".
"""

import math
from array import array
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import shown
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.camera.lenses import FISHEYE
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
    element,
)
from jaxbundle.io.formats.source import AGAIN, XmlNumbers, child_text, elements, local
from jaxbundle.io.formats.written import in_pixels, losses_of_block
from jaxbundle.io.noted import Noted
from jaxbundle.io.text_files import UnreadableError, file_bytes

HEAD = 2000  # bytes that contain the root element
AXES = {
    "Right": (1.0, 0.0),
    "Left": (-1.0, 0.0),
    "Down": (0.0, 1.0),
    "Up": (0.0, -1.0),
}  # axes of CameraOrientation in x right, y down
SIGMAS = (0.01, 0.01)  # m: default of Bentley's program for control points without accuracies
DISTORTION = ("K1", "K2", "K3", "P1", "P2")
CATEGORIES = {"Full": (1, 1), "Horizontal": (1, 0), "Vertical": (0, 1)}


def is_blocks_exchange(path: Path) -> bool:
    """Whether a file has the root element BlocksExchange."""
    try:
        return not path.is_dir() and b"<BlocksExchange" in file_bytes(path, HEAD)
    except UnreadableError:
        return False


def read_blocks_exchange(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the first block of the file.

    Raises: BlockError with all problems.
    """
    reader = _Reader(path)
    for tag, one in elements(path, "SRS", "Photogroup", "ControlPoint", "TiePoint", "ScaleConstraint"):
        reader.take(tag, one)
    return reader.block()


class _Reader:
    """Content that was read so far; one method for each kind of element."""

    def __init__(self, path: Path):
        self.path, self.noted = path, Noted()
        self.numbers = XmlNumbers(path, self.noted)
        self.systems: list[str] = []
        self.cameras: list[ForeignCamera] = []
        self.ids: dict[str, int] = {}
        self.names: list[str] = []
        self.camera_of: list[int] = []
        self.rotations: list[Float[np.ndarray, "3 3"]] = []
        self.centres: list[tuple[float, float, float]] = []
        self.points: list[str] = []
        self.coordinates = array("d")  # of millions of points: numbers as they are, not as objects
        self.rays = array("d")
        self.control: list[Known] = []
        self.distances: list[Distance] = []
        self.lost = 0

    def take(self, tag: str, one: ElementTree.Element) -> None:
        match tag:
            case "SRS":
                self.systems.append(child_text(one, "Definition"))
            case "Photogroup":
                self._photogroup(one)
            case "ControlPoint":
                self._control_point(one)
            case "TiePoint":
                self._tie_point(one)
            case _:
                self._constraint(one)

    def _photogroup(self, group: ElementTree.Element) -> None:
        name = child_text(group, "Name") or f"group {len(self.cameras) + 1}"
        self.cameras.append(self._camera(group, name))
        orientation = child_text(group, "CameraOrientation") or "XRightYDown"
        axes = self._axes(orientation)
        for photo in group.iter():
            if local(photo) != "Photo":
                continue
            number = child_text(photo, "Id")
            path = child_text(photo, "ImagePath")
            self.ids[number] = len(self.names)
            self.names.append(path.replace("\\", "/") or number)
            self.camera_of.append(len(self.cameras) - 1)
            matrix = self._matrix(photo, number)
            self.rotations.append(matrix.T @ axes.T @ rotations.DOWN_FORWARD)
            what = f"photo {number}"
            self.centres.append(self._triple(photo, "Pose/Center/", what))

    def _axes(self, orientation: str) -> Float[np.ndarray, "3 3"]:
        """Matrix with rows: axes x right, y down, z forward in the axes of the camera of the file."""
        found = [AXES.get(word) for word in orientation.replace("X", "").split("Y")]
        if len(found) != 2 or found[0] is None or found[1] is None:
            self.noted.add(self.path.name, 0, f"CameraOrientation {shown(orientation)} is unknown", AGAIN)
            return np.eye(3)
        x, y = np.array([*found[0], 0.0]), np.array([*found[1], 0.0])
        return np.column_stack([x, y, np.cross(x, y)])

    def _triple(self, one: ElementTree.Element, place: str, what: str) -> tuple[float, float, float]:
        x, y, z = (self.numbers.of(one, f"{place}{axis}", what) for axis in "xyz")
        return x, y, z

    def _matrix(self, photo: ElementTree.Element, number: str) -> Float[np.ndarray, "3 3"]:
        rotation, what = photo.find("Pose/Rotation"), f"photo {number}"
        if rotation is None:
            return np.full((3, 3), np.nan)
        if rotation.find("M_00") is not None:
            rows = [[self.numbers.of(rotation, f"M_{i}{j}", what) for j in range(3)] for i in range(3)]
            return np.array(rows)
        if rotation.find("Omega") is None:
            what = f"photo {number} has a rotation that is neither a matrix nor omega, phi, kappa"
            self.noted.add(self.path.name, 0, what, "export it as a matrix")
            return np.full((3, 3), np.nan)
        angles = np.radians([[self.numbers.of(rotation, name, what) for name in ("Omega", "Phi", "Kappa")]])
        return rotations.from_angles(angles)[0].T

    def _camera(self, group: ElementTree.Element, name: str) -> ForeignCamera:
        what = f"photogroup {shown(name)}"
        width, height = (self.numbers.of(group, f"ImageDimensions/{side}", what) for side in ("Width", "Height"))
        model = child_text(group, "CameraModelType") or "Perspective"
        if not (1 <= width < 1e8 and 1 <= height < 1e8):
            self.noted.add(self.path.name, 0, f"{what} has no ImageDimensions in px", "add Width and Height")
            width = height = 1.0
        size = max(width, height)
        f = self.numbers.of(group, "FocalLengthPixels", what)
        if math.isnan(f):
            length, sensor = self.numbers.of(group, "FocalLength", what), self.numbers.of(group, "SensorSize", what)
            pixel = self.numbers.of(group, "PixelSize", what)
            f = length / pixel if math.isnan(sensor) else length * size / sensor if sensor else math.nan
        if not f > 0:
            cure = "give FocalLengthPixels, or FocalLength and SensorSize"
            self.noted.add(self.path.name, 0, f"{what} has no principal distance", cure)
        if model not in ("Perspective", "Fisheye"):
            self.noted.add(
                self.path.name, 0, f"{what} has the model {shown(model)}", "read are Perspective and Fisheye"
            )
        if model == "Fisheye" and any(one.tag.startswith("Fisheye") for one in group):
            cure = "undistort the images, or export the project in another format"
            self.noted.add(self.path.name, 0, f"{what} has a fisheye matrix, whose meaning is not public", cure)
        elements_ = {name: self.numbers.of(group, f"Distortion/{name}", what, 0.0) for name in DISTORTION}
        aspect = self.numbers.of(group, "AspectRatio", what, 1.0)
        elements_ |= {
            "principal_distance": f * aspect,
            "b1": f - f * aspect,
            "b2": self.numbers.of(group, "Skew", what, 0.0),
            "x0": self._principal(group, "x", width, what),
            "y0": self._principal(group, "y", height, what),
        }
        estimate = ("principal_distance", "x0", "y0", *(key for key in DISTORTION if elements_[key]))
        of = FISHEYE if model == "Fisheye" else METASHAPE
        return ForeignCamera(name, of, elements_, estimate, "px", int(width), int(height))

    def _principal(self, group: ElementTree.Element, axis: str, side: float, what: str) -> float:
        value = self.numbers.of(group, f"PrincipalPoint/{axis}", what, (side - 1) / 2)
        return value + 0.5

    def _measurements(self, one: ElementTree.Element, point: int, name: str) -> None:
        what = f"point {shown(name)}"
        for row in one:
            if local(row) != "Measurement":
                continue
            number = child_text(row, "PhotoId")
            x, y = (self.numbers.of(row, axis, what) for axis in "xy")
            if number not in self.ids:
                self.lost += 1
            elif math.isnan(x) or math.isnan(y):
                cure = "export the measurements in px"
                self.noted.add(self.path.name, 0, f"point {shown(name)} has a measurement without x and y", cure)
            else:
                self.rays.extend((self.ids[number], point, x + 0.5, y + 0.5))

    def _tie_point(self, one: ElementTree.Element) -> None:
        point = len(self.points)
        self.points.append(child_text(one, "Id") or f"tie {point + 1}")
        self.coordinates.extend(self._triple(one, "Position/", self.points[-1]))
        self._measurements(one, point, self.points[-1])

    def _control_point(self, one: ElementTree.Element) -> None:
        point, name = (
            len(self.points),
            child_text(one, "Name") or child_text(one, "Id") or f"control {len(self.control)}",
        )
        plan, height = CATEGORIES.get(child_text(one, "Category") or "Full", (1, 1))
        horizontal = self.numbers.of(one, "HorizontalAccuracy", name, SIGMAS[0]) if plan else math.nan
        vertical = self.numbers.of(one, "VerticalAccuracy", name, SIGMAS[1]) if height else math.nan
        check = child_text(one, "CheckPoint").lower() in ("true", "1")
        place = self._triple(one, "Position/", name)
        self.control.append(Known(name, place, (horizontal, horizontal, vertical), check))
        self.points.append(name)
        self.coordinates.extend((math.nan, math.nan, math.nan))
        self._measurements(one, point, name)

    def _constraint(self, one: ElementTree.Element) -> None:
        start, end = (
            child_text(one, "PointA") or child_text(one, "A"),
            child_text(one, "PointB") or child_text(one, "B"),
        )
        distance = self.numbers.of(one, "DistanceAB", "a scale constraint")
        sigma = self.numbers.of(one, "Accuracy", "a scale constraint", 0.01)
        if start and end and distance > 0 and sigma > 0:
            self.distances.append(Distance(start, end, distance, sigma))

    def block(self) -> ForeignBlock:
        """Makes the block of the whole content. Raises: BlockError with all noted problems."""
        if not self.names:
            self.noted.add(self.path.name, 0, "there is no photo", "export the block with its photos")
        findings = []
        if self.lost:
            what = f"{self.lost} measurements are on photos that are not in the file"
            findings.append(Finding(Kind.UNUSED, what, grade=Severity.NOTE))
        if self.noted:
            raise self.noted.error()
        rays = np.array(self.rays).reshape(-1, 4)
        return ForeignBlock(
            format="BlocksExchange file",
            name=self.path.resolve().stem,
            cameras=tuple(self.cameras),
            images=Images(
                tuple(self.names),
                np.array(self.camera_of, np.int64),
                np.array(self.rotations).reshape(-1, 3, 3),
                np.array(self.centres).reshape(-1, 3),
            ),
            points=Points(tuple(self.points), np.array(self.coordinates).reshape(-1, 3)),
            rays=RayTable(rays[:, 0].astype(np.int64), rays[:, 1].astype(np.int64), rays[:, 2:]),
            control=tuple(self.control),
            distances=tuple(self.distances),
            coordinate_system=next((text for text in self.systems if text), ""),
            assumptions=("image coordinates have a standard deviation of 1 px",),
            findings=tuple(findings),
        )


def write_blocks_exchange(block: Block, path: Path) -> list[str]:
    """Writes version 2.1, one photogroup for each camera, matrices and XRightYDown.

    Returns: sentences about what the format cannot represent.
    """
    written = in_pixels(block, _holds)
    foreign = written.foreign
    matrix, _ = rotations.to_camera(foreign.images.rotation, foreign.images.centre)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8") as file:
        name = escape(foreign.name)
        system = escape(foreign.coordinate_system)
        file.write('<?xml version="1.0" encoding="utf-8"?>\n<BlocksExchange version="2.1">\n')
        if system:
            file.write(
                "<SpatialReferenceSystems><SRS><Id>0</Id>"
                f"<Definition>{system}</Definition></SRS></SpatialReferenceSystems>\n"
            )
        file.write(f"<Block><Name>{name}</Name>{'<SRSId>0</SRSId>' if system else ''}<Photogroups>\n")
        for k, camera in enumerate(foreign.cameras):
            file.write(_group(camera))
            for image in np.flatnonzero(foreign.images.camera == k).tolist():
                file.write(_photo(foreign, image, matrix[image]))
            file.write("</Photogroup>\n")
        file.write("</Photogroups>\n")
        rays = _measurements(foreign)
        control = {row.name: row for row in foreign.control}
        known = [row for row in foreign.control if np.isfinite(row.coordinates).any()]
        position = {name: k for k, name in enumerate(foreign.points.names)}
        file.write("<ControlPoints>\n" + "".join(_control(row, rays(position[row.name])) for row in known))
        file.write("</ControlPoints>\n<TiePoints>\n")
        for k, (name, place) in enumerate(zip(foreign.points.names, foreign.points.coordinates.tolist(), strict=True)):
            if name not in control:
                file.write(f"<TiePoint><Id>{escape(name)}</Id>{_place('Position', place)}{rays(k)}</TiePoint>\n")
        file.write("</TiePoints></Block></BlocksExchange>\n")
    kept = frozenset({"control"})
    return [*written.losses, *losses_of_block(block, kept)]


def _holds(camera: ForeignCamera) -> bool:
    others = ("K4", "b2")
    return camera.model is METASHAPE and not any(element(camera, name) for name in others)


def _group(camera: ForeignCamera) -> str:
    f, b1 = element(camera, "principal_distance"), element(camera, "b1")
    terms = "".join(f"<{name}>{element(camera, name):.17g}</{name}>" for name in DISTORTION)
    x0, y0 = element(camera, "x0") - 0.5, element(camera, "y0") - 0.5
    return (
        f"<Photogroup><Name>{escape(camera.name)}</Name><ImageDimensions><Width>{camera.width}</Width>"
        f"<Height>{camera.height}</Height></ImageDimensions><CameraModelType>Perspective</CameraModelType>"
        f"<FocalLengthPixels>{f + b1:.17g}</FocalLengthPixels><CameraOrientation>XRightYDown</CameraOrientation>"
        f"<PrincipalPoint><x>{x0:.17g}</x><y>{y0:.17g}</y></PrincipalPoint><Distortion>{terms}</Distortion>"
        f"<AspectRatio>{f / (f + b1):.17g}</AspectRatio>\n"
    )


def _place(tag: str, place) -> str:
    inside = "".join(f"<{axis}>{value:.17g}</{axis}>" for axis, value in zip("xyz", place, strict=True))
    return f"<{tag}>{inside}</{tag}>"


def _photo(foreign: ForeignBlock, image: int, matrix: Float[np.ndarray, "3 3"]) -> str:
    rows = "".join(f"<M_{i}{j}>{matrix[i, j]:.17g}</M_{i}{j}>" for i in range(3) for j in range(3))
    centre = _place("Center", foreign.images.centre[image])
    return (
        f"<Photo><Id>{image}</Id><ImagePath>{escape(foreign.images.names[image])}</ImagePath>"
        f"<Pose><Rotation>{rows}</Rotation>{centre}</Pose></Photo>\n"
    )


def _measurements(foreign: ForeignBlock):
    """The measurements of each point as text, by the number of the point."""
    rays = foreign.rays
    order = np.argsort(rays.point, kind="stable")
    ends = np.searchsorted(rays.point[order], np.arange(len(foreign.points.names) + 1))
    xy = rays.xy - 0.5

    def of_point(point: int) -> str:
        return "".join(
            f"<Measurement><PhotoId>{rays.image[r]}</PhotoId><x>{xy[r, 0]:.17g}</x><y>{xy[r, 1]:.17g}</y></Measurement>"
            for r in order[ends[point] : ends[point + 1]].tolist()
        )

    return of_point


def _control(row: Known, rays: str) -> str:
    plan, height = np.isfinite(row.sigmas[:2]).all(), np.isfinite(row.sigmas[2])
    category = "Full" if plan and height else "Horizontal" if plan else "Vertical"
    check = "<CheckPoint>true</CheckPoint>" if row.check else ""
    place = np.nan_to_num(row.coordinates)
    horizontal, vertical = np.nan_to_num([row.sigmas[0], row.sigmas[2]])
    return (
        f"<ControlPoint><Name>{escape(row.name)}</Name><Category>{category}</Category>{_place('Position', place)}"
        f"{check}<HorizontalAccuracy>{horizontal:.17g}</HorizontalAccuracy>"
        f"<VerticalAccuracy>{vertical:.17g}</VerticalAccuracy>{rays}</ControlPoint>\n"
    )
