"""Reading and writing MicMac: a folder of orientations (Ori-*), ground points with measurements, homologous points.

    Orientation-IMAGE.xml    Centre, ParamRotation: rows L1 L2 L3 of world from camera, or three angles; FileInterne
    AutoCal*.xml             PP, F, SzIm, CalibDistortion
    Dico-Appuis.xml          OneAppuisDAF: Pt, NamePt, Incertitude
    Mesure-Appuis.xml        MesureAppuiFlottant1Im: NameIm; OneMesureAF1I: NamePt, PtIm
    Homol*/Pastis*/*.txt     pairs of homologous points, x1 y1 x2 y2

X_c = L^T (X - Centre), q = PP + F (X_c / Z_c, Y_c / Z_c), image = CDist + (q - CDist)(1 + a1 r^2 + a2 r^4 + ...): the
camera model `metashape` with K_i = a_i F^2i where CDist is PP. R_jb = L D. Scanned film has mm, y down; OrIntImaM2C
transforms them to the pixels of the scan. Source: MicMac documentation, "Geometric formats and conventions" (IGN).
"""

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import shown
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.collected import IN_PX, Collected
from jaxbundle.io.formats.foreign_block import DEFAULT, ForeignBlock, ForeignCamera, Known, ReadOptions, element
from jaxbundle.io.formats.source import AGAIN, XmlNumbers, child_text, lines_of, local, numbers, tree_of
from jaxbundle.io.formats.written import in_pixels, losses_of_block
from jaxbundle.io.noted import Noted

PREFIX, SUFFIX = "Orientation-", ".xml"
ANGLES = {
    "eConvAngPhotoMDegre": np.pi / 180,
    "eConvAngPhotoMGrade": np.pi / 200,
}
SAME_CENTRE = 1e-9  # share of F: below it, centre of distortion and principal point are equal
FEW_DIGITS = 1e-6  # px, tolerance of the coordinates of pairs: two measurements of one point


def is_micmac(path: Path) -> bool:
    """Whether a folder contains orientations of MicMac, or one folder Ori-* with them."""
    return path.is_dir() and _folder(path) is not None


def _folder(path: Path) -> Path | None:
    if next(path.glob(f"{PREFIX}*{SUFFIX}"), None) is not None:
        return path
    below = [one for one in sorted(path.glob("Ori-*")) if next(one.glob(f"{PREFIX}*{SUFFIX}"), None) is not None]
    return below[0] if len(below) == 1 else None


def read_micmac(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the orientations of a folder, and its ground points and homologous points.

    Without ground points and homologous points the verification points in the orientation files are the rays.

    Raises: BlockError with all problems.
    """
    folder = _folder(path) or path
    reader = _Reader(folder)
    for file in sorted(folder.glob(f"{PREFIX}*{SUFFIX}")):
        reader.orientation(file)
    project = folder.parent if folder.name.startswith("Ori-") else folder
    for file in (*sorted(project.glob("Dico-Appuis*.xml")), *sorted(project.glob("Appui*.xml"))):
        reader.ground_points(file)
    for file in sorted(project.glob("Mesure-Appuis*.xml")):
        reader.measurements(file)
    reader.homologous(project)
    if not reader.found.rays:
        reader.verified()
    return reader.block(path)


class _Verified(NamedTuple):
    """A verification point of an orientation."""

    image: str
    name: str
    xy: tuple[float, float]
    place: tuple[float, float, float]


class _Reader:
    """Content of a project that was read so far."""

    def __init__(self, folder: Path):
        self.folder, self.noted, self.found = folder, Noted(), Collected()
        self.cameras: dict[str, ForeignCamera] = {}
        self.control: dict[str, Known] = {}
        self.checks: list[_Verified] = []
        self.findings: list[Finding] = []

    def orientation(self, path: Path) -> None:
        """Reads one image."""
        root, image = tree_of(path), path.name[len(PREFIX) : -len(SUFFIX)]
        one = root if local(root) == "OrientationConique" else root.find(".//OrientationConique")
        read = XmlNumbers(path, self.noted)
        if one is None:
            self.noted.add(path.name, 0, "there is no OrientationConique", AGAIN)
            return
        centre = read.array(child_text(one, "Externe/Centre"), 3, "Centre")
        matrix = self._matrix(path, one, read)
        name = self._interior(path, one)
        self.found.image(image)
        self.found.camera[image] = name
        if centre is not None and matrix is not None:
            self.found.orientation[image] = centre, np.zeros(3)
            self.found.matrix[image] = matrix @ rotations.DOWN_FORWARD
        for k, row in enumerate(one.findall(".//Verif/Appuis")):
            xy = read.array(child_text(row, "Im"), 2, "Im")
            place = read.array(child_text(row, "Ter"), 3, "Ter")
            if xy is not None and place is not None:
                x, y, z = place.tolist()
                self.checks.append(_Verified(image, f"{image} {k}", (float(xy[0]), float(xy[1])), (x, y, z)))

    def _matrix(self, path: Path, one: ElementTree.Element, read: XmlNumbers) -> Float[np.ndarray, "3 3"] | None:
        rotation = one.find("Externe/ParamRotation")
        if rotation is not None and rotation.find("CodageMatr") is not None:
            rows = [read.array(child_text(rotation, f"CodageMatr/L{k}"), 3, f"L{k}") for k in (1, 2, 3)]
            return None if any(row is None for row in rows) else np.array(rows)
        convention = child_text(one, "ConvOri/KnownConv")
        angles = read.array(child_text(rotation, "CodageAngulaire"), 3, "CodageAngulaire")
        if convention not in ANGLES:
            what = f"the angles have the convention {shown(convention or 'none')}"
            self.noted.add(path.name, 0, what, f"read are matrices, and {', '.join(ANGLES)}; OriConvert writes them")
            return None
        if angles is None:
            return None
        return rotations.from_angles(angles[None] * ANGLES[convention])[0] @ rotations.DOWN_FORWARD

    def _interior(self, path: Path, one: ElementTree.Element) -> str:
        """The name of the image's camera; a new camera is read."""
        inside, file = one.find("Interne"), child_text(one, "FileInterne")
        name = Path(file).stem if file else f"camera of {path.name[len(PREFIX) : -len(SUFFIX)]}"
        if name in self.cameras:
            return name
        if inside is None:
            places = [self.folder / Path(file).name, self.folder.parent / file]
            found = next((place for place in places if file and place.is_file()), None)
            if found is None:
                self.noted.add(path.name, 0, f"its interior orientation {shown(file)} is missing", "add the file")
                return name
            root = tree_of(found)
            inside = root if root.find("F") is not None else root.find(".//CalibrationInternConique")
            path = found
        camera = self._camera(path, inside, name)
        if camera is not None:
            self.cameras[name] = camera
        return name

    def _camera(self, path: Path, one: ElementTree.Element | None, name: str) -> ForeignCamera | None:
        read = XmlNumbers(path, self.noted)
        if one is None:
            self.noted.add(path.name, 0, "there is no CalibrationInternConique", AGAIN)
            return None
        f, point = read.of(one, "F", "the camera"), read.array(child_text(one, "PP"), 2, "PP")
        size = read.array(child_text(one, "SzIm"), 2, "SzIm")
        if point is None or size is None or not f > 0:
            self.noted.add(path.name, 0, "the camera has no F, PP or SzIm", AGAIN)
            return None
        elements = {"principal_distance": f}
        distortion = one.find("CalibDistortion")
        for model in [] if distortion is None else list(distortion):
            elements |= self._distortion(path, model, (f, point), read)
        scanned = child_text(one, "ScannedAnalogik") == "true"
        if scanned:
            elements |= {"x0": point[0], "y0": -point[1]}
            return ForeignCamera(name, METASHAPE, elements, (), "mm")
        elements |= {"x0": point[0], "y0": point[1]}
        estimate = (
            "principal_distance",
            "x0",
            "y0",
            *(key for key, value in elements.items() if key[0] == "K" and value),
        )
        return ForeignCamera(name, METASHAPE, elements, estimate, "px", int(size[0]), int(size[1]))

    def _distortion(
        self, path: Path, model: ElementTree.Element, camera: tuple[float, np.ndarray], read: XmlNumbers
    ) -> dict[str, float]:
        """Distortion coefficients for c = 1."""
        f, point = camera
        cure = "export a calibration of the models ModRad or ModPhgrStd, or undistort the images"
        radial = model if local(model) == "ModRad" else model.find("RadialePart")
        if local(model) == "ModNoDist":
            return {}
        if local(model) not in ("ModRad", "ModPhgrStd") or radial is None:
            self.noted.add(path.name, 0, f"the distortion {shown(local(model))} is not read", cure)
            return {}
        centre = read.array(child_text(radial, "CDist"), 2, "CDist")
        values = [read.of_text((one.text or "").strip(), "CoeffDist") for one in radial.findall("CoeffDist")]
        if centre is not None and np.abs(centre - point).max() > SAME_CENTRE * f and any(values):
            self.noted.add(path.name, 0, "the centre of distortion is not the principal point", cure)
        if any(values[4:]):
            self.noted.add(path.name, 0, f"there are {len(values)} radial coefficients, read are 4", cure)
        terms = {f"K{k}": value * f ** (2 * k) for k, value in enumerate(values[:4], 1)}
        if local(model) == "ModPhgrStd":
            p1, p2, b1, b2 = (read.of(model, key, "ModPhgrStd", 0.0) for key in ("P1", "P2", "b1", "b2"))
            terms |= {"P1": p1 * f, "P2": p2 * f, "b1": b1 * f, "b2": b2 * f}
        return terms

    def ground_points(self, path: Path) -> None:
        """Reads the coordinates of ground points."""
        read = XmlNumbers(path, self.noted)
        for one in tree_of(path).iter("OneAppuisDAF"):
            name, place = child_text(one, "NamePt"), read.array(child_text(one, "Pt"), 3, "Pt")
            sigma = read.array(child_text(one, "Incertitude") or "1 1 1", 3, "Incertitude")
            if name and place is not None and sigma is not None and (sigma > 0).all():
                (x, y, z), (sx, sy, sz) = place.tolist(), sigma.tolist()
                self.control[name] = Known(name, (x, y, z), (sx, sy, sz))

    def measurements(self, path: Path) -> None:
        """Reads the image coordinates of ground points."""
        read = XmlNumbers(path, self.noted)
        for image in tree_of(path).iter("MesureAppuiFlottant1Im"):
            name = child_text(image, "NameIm")
            for one in image.findall("OneMesureAF1I"):
                xy = read.array(child_text(one, "PtIm"), 2, "PtIm")
                if xy is not None and name in self.found.images:
                    self._ray(name, child_text(one, "NamePt"), float(xy[0]), float(xy[1]))

    def _ray(self, image: str, point: str, x: float, y: float) -> None:
        camera = self.cameras.get(self.found.camera.get(image, ""))
        down = -1.0 if camera is not None and camera.image_unit == "mm" else 1.0
        self.found.ray(image, point, x, down * y)

    def homologous(self, project: Path) -> None:
        """Tie points from pairs: measurements with the same image coordinates are one ray."""
        parent: dict[tuple[str, int, int], tuple[str, int, int]] = {}

        def root(one: tuple[str, int, int]) -> tuple[str, int, int]:
            while parent.setdefault(one, one) != one:
                parent[one] = parent[parent[one]]
                one = parent[one]
            return one

        places: dict[tuple[str, int, int], tuple[float, float]] = {}
        for folder in sorted(project.glob("Homol*/Pastis*")):
            one = folder.name.removeprefix("Pastis")
            for file in sorted(folder.glob("*.txt")):
                for line, text in enumerate(lines_of(file), 1):
                    values = numbers(file, line, text.split()[:4], self.noted) if text.strip() else None
                    if values is None or len(values) < 4:
                        continue
                    keys = []
                    for image, x, y in ((one, *values[:2]), (file.stem, *values[2:])):
                        key = (image, round(x / FEW_DIGITS), round(y / FEW_DIGITS))
                        places[key] = (x, y)
                        keys.append(key)
                    parent[root(keys[0])] = root(keys[1])
        names: dict[tuple[str, int, int], str] = {}
        for key, (x, y) in places.items():
            if key[0] in self.found.images:
                self._ray(key[0], names.setdefault(root(key), f"tie {len(names) + 1}"), x, y)

    def verified(self) -> None:
        """Rays of the verification points in the orientation files."""
        for check in self.checks:
            self._ray(check.image, check.name, *check.xy)
            self.found.coordinates[check.name] = check.place

    def block(self, path: Path) -> ForeignBlock:
        """Makes the block. Raises: BlockError with all noted problems."""
        if not self.found.images:
            self.noted.add(path.name, 0, f"there is no {PREFIX}*{SUFFIX}", "give a folder Ori-*")
        if self.noted:
            raise self.noted.error()
        names = list(self.cameras)
        self.found.control = {name: row for name, row in self.control.items() if name in self.found.points}
        left = len(self.control) - len(self.found.control)
        if left:
            self.findings.append(Finding(Kind.UNUSED, f"{left} ground points are not measured", grade=Severity.NOTE))
        return ForeignBlock(
            format="MicMac project",
            name=path.resolve().name,
            cameras=tuple(self.cameras.values()),
            images=self.found.images_with(names, rotations.from_angles),
            points=self.found.points_found(),
            rays=self.found.ray_table(),
            control=self.found.measured_control(),
            assumptions=(IN_PX, "image coordinates count from the corner of the image"),
            findings=tuple(self.findings),
        )


def write_micmac(block: Block, path: Path) -> list[str]:
    """Writes Ori-jaxbundle, Dico-Appuis.xml and Mesure-Appuis.xml into a folder; tie points as homologous pairs.

    Returns: sentences about what the format cannot represent.
    """
    written = in_pixels(block, _holds)
    foreign = written.foreign
    folder = path / "Ori-jaxbundle"
    folder.mkdir(parents=True, exist_ok=True)
    files = {k: f"AutoCal-{k + 1}.xml" for k in range(len(foreign.cameras))}
    for k, camera in enumerate(foreign.cameras):
        (folder / files[k]).write_text(_calibration(camera), encoding="utf-8")
    matrix = foreign.images.rotation @ rotations.DOWN_FORWARD
    for k, name in enumerate(foreign.images.names):
        text = _oriented(foreign.images.centre[k], matrix[k], f"Ori-jaxbundle/{files[int(foreign.images.camera[k])]}")
        (folder / f"{PREFIX}{name.replace('/', '_')}{SUFFIX}").write_text(text, encoding="utf-8")
    control = {row.name for row in foreign.control}
    known = [row for row in foreign.control if np.isfinite(row.coordinates).all() and not row.check]
    (path / "Dico-Appuis.xml").write_text(_dictionary(known), encoding="utf-8")
    _write_measurements(foreign, path, control)
    _write_pairs(foreign, path, control)
    losses = [] if not any("/" in name for name in foreign.images.names) else ["folders in the names of images"]
    return [*written.losses, *losses, *losses_of_block(block, frozenset({"control"}))]


def _holds(camera: ForeignCamera) -> bool:
    return camera.model is METASHAPE and not any(element(camera, name) for name in ("P1", "P2", "b1", "b2"))


def _numbers(values) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def _calibration(camera: ForeignCamera) -> str:
    f, point = element(camera, "principal_distance"), (element(camera, "x0"), element(camera, "y0"))
    terms = [element(camera, f"K{k}") / f ** (2 * k) for k in (1, 2, 3, 4)]
    radial = "".join(f"<CoeffDist>{value:.17g}</CoeffDist>" for value in terms)
    return (
        "<?xml version='1.0' ?>\n<ExportAPERO><CalibrationInternConique><KnownConv>eConvApero_DistM2C</KnownConv>"
        f"<PP>{_numbers(point)}</PP><F>{f:.17g}</F><SzIm>{camera.width} {camera.height}</SzIm><CalibDistortion><ModRad>"
        f"<CDist>{_numbers(point)}</CDist>{radial}</ModRad></CalibDistortion></CalibrationInternConique></ExportAPERO>\n"
    )


def _oriented(centre: Float[np.ndarray, "3"], matrix: Float[np.ndarray, "3 3"], file: str) -> str:
    rows = "".join(f"<L{k + 1}>{_numbers(matrix[k])}</L{k + 1}>" for k in range(3))
    return (
        "<?xml version='1.0' ?>\n<ExportAPERO><OrientationConique>"
        "<OrIntImaM2C><I00>0 0</I00><V10>1 0</V10><V01>0 1</V01>"
        f"</OrIntImaM2C><TypeProj>eProjStenope</TypeProj><FileInterne>{escape(file)}</FileInterne>"
        "<RelativeNameFI>false</RelativeNameFI><Externe><KnownConv>eConvApero_DistM2C</KnownConv>"
        f"<Centre>{_numbers(centre)}</Centre><ParamRotation><CodageMatr>{rows}</CodageMatr></ParamRotation></Externe>"
        "</OrientationConique></ExportAPERO>\n"
    )


def _dictionary(rows: list[Known]) -> str:
    points = "".join(
        f"<OneAppuisDAF><Pt>{_numbers(row.coordinates)}</Pt><NamePt>{escape(row.name)}</NamePt>"
        f"<Incertitude>{_numbers(s if s > 0 else 0.001 for s in np.nan_to_num(row.sigmas, nan=1e6))}</Incertitude>"
        "</OneAppuisDAF>\n"
        for row in rows
    )
    return f"<?xml version='1.0' ?>\n<DicoAppuisFlottant>\n{points}</DicoAppuisFlottant>\n"


def _write_measurements(foreign: ForeignBlock, path: Path, control: set[str]) -> None:
    parts = []
    for k, image in enumerate(foreign.images.names):
        rows = [
            f"<OneMesureAF1I><NamePt>{escape(foreign.points.names[foreign.rays.point[r]])}</NamePt>"
            f"<PtIm>{_numbers(foreign.rays.xy[r])}</PtIm></OneMesureAF1I>"
            for r in np.flatnonzero(foreign.rays.image == k).tolist()
            if foreign.points.names[foreign.rays.point[r]] in control
        ]
        name = escape(image.replace("/", "_"))
        parts.append(f"<MesureAppuiFlottant1Im><NameIm>{name}</NameIm>{''.join(rows)}</MesureAppuiFlottant1Im>\n")
    text = f"<?xml version='1.0' ?>\n<SetOfMesureAppuisFlottants>\n{''.join(parts)}</SetOfMesureAppuisFlottants>\n"
    (path / "Mesure-Appuis.xml").write_text(text, encoding="utf-8")


def _write_pairs(foreign: ForeignBlock, path: Path, control: set[str]) -> None:
    """Writes each tie point as pairs of its first image with each other image, in both directions."""
    rays, names = foreign.rays, [name.replace("/", "_") for name in foreign.images.names]
    pairs: dict[tuple[int, int], list[str]] = {}
    order = np.argsort(rays.point, kind="stable")
    ends = np.searchsorted(rays.point[order], np.arange(len(foreign.points.names) + 1))
    for k, name in enumerate(foreign.points.names):
        some = [] if name in control else order[ends[k] : ends[k + 1]].tolist()
        for other in some[1:]:
            for a, b in ((some[0], other), (other, some[0])):
                row = f"{_numbers(rays.xy[a])} {_numbers(rays.xy[b])}"
                pairs.setdefault((int(rays.image[a]), int(rays.image[b])), []).append(row)
    for (a, b), rows in pairs.items():
        folder = path / "Homol" / f"Pastis{names[a]}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{names[b]}.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
