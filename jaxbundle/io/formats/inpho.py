"""Reading Inpho projects (.prj) of Match-AT and OrthoMaster.

    $SECTION [: value] ... $END,  $KEY : value, rows of data below a key
    pixel = A (x, y) mm + (u0, v0)      $CCD_INTERIOR_ORIENTATION, two rows; CenterTopLeft: half a pixel is added
    $EXT_ORI : time / c X Y Z / three rows of image_from_object, x right, y up, z back

Cameras become px cameras by A. Radial coefficients are not read, as their sign and unit are not public. Source: the
grammar on which public readers and writers agree, among them MicMac.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import shown
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats.collected import CONTROL, CONTROL_SIGMAS, IN_PX, Collected, mm_camera, transposed
from jaxbundle.io.formats.foreign_block import DEFAULT, Alternative, ForeignBlock, ForeignCamera, Known, ReadOptions
from jaxbundle.io.formats.source import AGAIN, lines_of, numbers
from jaxbundle.io.noted import Noted
from jaxbundle.io.text_files import UnreadableError, file_bytes

HEAD = b"$PROJECT"
ENDS = ("$END", "$END_POINTS", "$END_COORDINATE_SYSTEM", "$ENDNAV")


def is_inpho(path: Path) -> bool:
    """Whether a file begins like a project of Inpho."""
    try:
        return not path.is_dir() and file_bytes(path, len(HEAD) + 3).lstrip(b"\xef\xbb\xbf").startswith(HEAD)
    except UnreadableError:
        return False


class _Camera:
    """The entries of a camera."""

    def __init__(self):
        self.values: dict[str, list[float]] = {}
        self.matrix: list[list[float]] = []


def read_inpho(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the project of a file.

    Raises: BlockError with all problems.
    """
    reader = _Reader(path)
    reader.read(lines_of(path))
    return reader.block()


class _Reader:
    """Content that was read so far, section by section."""

    def __init__(self, path: Path):
        self.path, self.noted, self.found = path, Noted(), Collected()
        self.cameras: dict[str, _Camera] = {}
        self.section, self.camera, self.photo, self.file, self.key = "", _Camera(), "", "", ""
        self.rows: list[list[float]] = []
        self.system: list[str] = []
        self.distorted = False

    def read(self, lines: list[str]) -> None:
        for number, text in enumerate(lines, 1):
            text = text.strip()
            if not text or text.startswith("#"):
                continue
            if text.startswith("$"):
                name, _, value = text.partition(":")
                self._key(number, name.strip().upper(), value.strip())
            else:
                self._row(number, text)

    def _key(self, line: int, name: str, value: str) -> None:
        self.key, self.rows = name, []
        if name in ("$CAMERA", "$CAMERA_DEFINITION"):
            self.section, self.camera = "camera", _Camera()
            if value:
                self.cameras[value] = self.camera
        elif name == "$PHOTO":
            self.section, self.photo = "photo", ""
        elif name == "$CONTROL_POINTS":
            self.section = "control"
        elif name == "$ADJUSTED_POINTS":
            self.section = "adjusted"
        elif name in ("$PROJECT", "$NAVIGATION", "$COORDINATE_SYSTEM_SET", "$COORDINATE_SYSTEM"):
            self.section = name
            self.system += [value] if name == "$COORDINATE_SYSTEM" and value else []
        elif name == "$END_POINTS":
            self.section = ""
        elif self.section == "camera":
            self._camera_key(line, name, value)
        elif self.section == "photo" and name in ("$PHOTO_NUM", "$PHOTO_FILE", "$CAMERA_ID"):
            self._photo_key(name, value)

    def _camera_key(self, line: int, name: str, value: str) -> None:
        if name in ("$ID", "$TYPE") and self.camera not in self.cameras.values() and value:
            self.cameras[value] = self.camera
        elif name in ("$FOCAL_LENGTH", "$CCD_COLUMNS", "$CCD_ROWS", "$PRINCIPAL_POINT_PPA", "$CAMERA_MOUNT_ROTATION"):
            found = numbers(self.path, line, value.split(), self.noted, name)
            if found:
                self.camera.values[name] = found

    def _photo_key(self, name: str, value: str) -> None:
        if name == "$PHOTO_NUM":
            self.photo = value
            self.found.image(value)
        elif name == "$CAMERA_ID":
            self.found.camera[self.photo] = value

    def _row(self, line: int, text: str) -> None:
        fields = text.replace("{", " ").replace("}", " ").split()
        if self.section == "camera" and self.key == "$CCD_INTERIOR_ORIENTATION":
            values = numbers(self.path, line, fields, self.noted, self.key)
            if values:
                self.camera.matrix.append(values)
        elif self.section == "camera" and self.key == "$RADIAL_COEFFS":
            self.distorted |= any(float(f) for f in numbers(self.path, line, fields, self.noted, self.key) or [])
        elif self.section == "photo" and self.key == "$EXT_ORI":
            self._orientation(line, fields)
        elif self.section == "photo" and self.key == "$PHOTO_POINTS":
            values = numbers(self.path, line, fields[1:3], self.noted) if len(fields) > 2 else None
            if len(fields) < 3:
                self.noted.add(self.path.name, line, f"the point has {len(fields)} fields, not id x y", AGAIN)
            if values:
                self.found.ray(self.photo, fields[0], values[0], values[1])
        elif self.section in ("control", "adjusted") and len(fields) >= 4 and self.key.endswith("_POINTS"):
            self._point(line, fields)
        elif self.section == "$COORDINATE_SYSTEM":
            self.system.append(text)

    def _orientation(self, line: int, fields: list[str]) -> None:
        values = numbers(self.path, line, fields, self.noted, "$EXT_ORI")
        if values is None:
            return
        self.rows.append(values)
        if len(self.rows) == 4:
            if [len(row) for row in self.rows] != [4, 3, 3, 3]:
                self.noted.add(
                    self.path.name, line, f"$EXT_ORI of photo {shown(self.photo)} is not c X Y Z and a matrix", AGAIN
                )
                return
            self.found.orientation[self.photo] = np.array(self.rows[0][1:]), np.zeros(3)
            self.found.matrix[self.photo] = np.array(self.rows[1:]).T

    def _point(self, line: int, fields: list[str]) -> None:
        values = numbers(self.path, line, fields[1:4], self.noted)
        if values is None:
            return
        place = (values[0], values[1], values[2])
        if self.section == "adjusted":
            self.found.coordinates[fields[0]] = place
            return
        more = numbers(self.path, line, fields[5:8], self.noted) if len(fields) >= 8 else None
        sigmas = CONTROL_SIGMAS if more is None or min(more) <= 0 else (more[0], more[1], more[2])
        self.found.control[fields[0]] = Known(fields[0], place, sigmas)

    def block(self) -> ForeignBlock:
        """Makes the block. Raises: BlockError with all noted problems."""
        names, cameras, forms = list(self.cameras), [], []
        for name in names:
            camera, form = self._camera(name)
            cameras.append(camera)
            forms.append(form)
        if not names:
            self.noted.add(self.path.name, 0, "there is no camera", "add $CAMERA_DEFINITION")
        if self.noted:
            raise self.noted.error()
        images = self.found.images_with(names, lambda rows: np.full((len(rows), 3, 3), np.nan))
        rays = self.found.ray_table()
        xy = rays.xy.copy()
        of_ray = images.camera[rays.image]
        for k, form in enumerate(forms):
            own = of_ray == k
            xy[own] = xy[own] @ form[:, :2].T + form[:, 2]
        findings = ()
        if self.distorted:
            what = "the radial coefficients of the cameras are not read: their sign and unit are not public"
            findings = (Finding(Kind.INFORMATION, what, "estimate K1 and K2", grade=Severity.CHECK),)
        in_px = all(camera.image_unit == "px" for camera in cameras)
        return ForeignBlock(
            format="Inpho project",
            name=self.path.resolve().stem,
            cameras=tuple(cameras),
            images=images,
            points=self.found.points_found(),
            rays=rays._replace(xy=xy),
            control=self.found.measured_control(),
            coordinate_system=" ".join(self.system),
            sigma=1.0 if in_px else 0.005,
            assumptions=(IN_PX, CONTROL) if self.found.control else (IN_PX,),
            findings=findings,
            reading="with the rows as image from object",
            alternatives=(Alternative("with the rows as object from image", transposed),),
        )

    def _camera(self, name: str) -> tuple[ForeignCamera, Float[np.ndarray, "2 3"]]:
        """A camera, and the matrix that transforms its rays from mm."""
        values, rows = self.cameras[name].values, self.cameras[name].matrix
        c = values.get("$FOCAL_LENGTH", [0.0])[0]
        if not c > 0:
            self.noted.add(self.path.name, 0, f"camera {shown(name)} has no $FOCAL_LENGTH", AGAIN)
        if any(values.get("$CAMERA_MOUNT_ROTATION", [0.0])):
            cure = "set the mount rotation in the project to 0, or export it without rotation"
            self.noted.add(self.path.name, 0, f"camera {shown(name)} has a mount rotation, which is not read", cure)
        point = np.array([*values.get("$PRINCIPAL_POINT_PPA", []), 0.0, 0.0][:2])
        if [len(row) for row in rows] != [3, 3]:
            if rows:
                self.noted.add(
                    self.path.name, 0, f"camera {shown(name)}: $CCD_INTERIOR_ORIENTATION is not two rows of 3", AGAIN
                )
            return mm_camera(name, c, *point.tolist()), np.eye(3)[:2]
        form = np.array(rows) + [[0, 0, 0.5], [0, 0, 0.5]]
        at = form[:, :2] @ point + form[:, 2]
        (a, b), (_, d) = form[:, :2]
        elements = {"principal_distance": -c * d, "b1": c * (a + d), "b2": -c * b, "x0": at[0], "y0": at[1]}
        size = [values.get(key, [0.0])[0] for key in ("$CCD_COLUMNS", "$CCD_ROWS")]
        width, height = (int(side) if 1 <= side < 1e8 else None for side in size)
        if form[1, 0]:
            self.noted.add(self.path.name, 0, f"camera {shown(name)} has rotated pixel axes, which are not read", AGAIN)
        return ForeignCamera(name, METASHAPE, elements, (), "px", width, height), form
