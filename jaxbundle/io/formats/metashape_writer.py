"""Writing cameras and markers for Metashape: XML in its export format, and references of markers as CSV.

The chunk has no transform: its system is that of the object. A marker is a control or check point with its rays; tie
points are not written, because Metashape cannot import them.
"""

import csv
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.foreign_block import ForeignBlock, ForeignCamera, element
from jaxbundle.io.formats.written import in_pixels, losses_of_block

VERSION = "1.5.0"
TERMS = {"k1": "K1", "k2": "K2", "k3": "K3", "k4": "K4", "p1": "P1", "p2": "P2", "b1": "b1", "b2": "b2"}
HEADER = ("#Label", "X", "Y", "Z", "sX", "sY", "sZ", "Enabled")
HELD = 1e-6  # object unit: the standard deviation of a fixed coordinate, because Metashape does not accept 0


def write_metashape(block: Block, path: Path) -> list[str]:
    """Writes one XML file, and NAME-reference.csv in the same folder.

    Returns: sentences about what the format cannot represent.
    """
    written = in_pixels(block, lambda camera: camera.model is METASHAPE)
    foreign, losses = written.foreign, list(written.losses)
    path.parent.mkdir(parents=True, exist_ok=True)
    root = ElementTree.Element("document", version=VERSION)
    chunk = ElementTree.SubElement(root, "chunk", label=foreign.name or "chunk", enabled="true")
    sensors = ElementTree.SubElement(chunk, "sensors")
    for k, camera in enumerate(foreign.cameras):
        _sensor(sensors, k, camera)
    _cameras(ElementTree.SubElement(chunk, "cameras"), foreign)
    _markers(chunk, foreign, losses)
    if foreign.coordinate_system:
        ElementTree.SubElement(chunk, "reference").text = foreign.coordinate_system
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    _references(path.with_name(f"{path.stem}-reference.csv"), foreign)
    marked = {row.name for row in foreign.control}
    ties = sum(name not in marked for name in foreign.points.names)
    if ties:
        losses.append(f"{ties} tie points and their rays")
    return [*losses, *losses_of_block(block, frozenset({"control", "sigmas"}))]


def _sensor(sensors: ElementTree.Element, number: int, camera: ForeignCamera) -> None:
    sensor = ElementTree.SubElement(sensors, "sensor", id=str(number), label=camera.name, type="frame")
    size = {"width": str(camera.width), "height": str(camera.height)}
    ElementTree.SubElement(sensor, "resolution", size)
    calibration = ElementTree.SubElement(sensor, "calibration", {"type": "frame", "class": "adjusted"})
    ElementTree.SubElement(calibration, "resolution", size)
    middle = (camera.width or 0) / 2, (camera.height or 0) / 2
    values = {"f": element(camera, "principal_distance")}
    values |= {"cx": element(camera, "x0") - middle[0], "cy": element(camera, "y0") - middle[1]}
    values |= {theirs: element(camera, ours) for theirs, ours in TERMS.items() if element(camera, ours)}
    for name, value in values.items():
        ElementTree.SubElement(calibration, name).text = f"{value:.17g}"


def _cameras(cameras: ElementTree.Element, foreign: ForeignBlock) -> None:
    images = foreign.images
    for k, name in enumerate(images.names):
        given = {"id": str(k), "sensor_id": str(images.camera[k]), "label": name, "enabled": "true"}
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = images.rotation[k] @ rotations.DOWN_FORWARD, images.centre[k]
        one = ElementTree.SubElement(cameras, "camera", given)
        ElementTree.SubElement(one, "transform").text = _row(matrix.ravel())


def _markers(chunk: ElementTree.Element, foreign: ForeignBlock, losses: list[str]) -> None:
    markers = ElementTree.SubElement(chunk, "markers")
    frame = ElementTree.SubElement(ElementTree.SubElement(chunk, "frames", next_id="1"), "frame", id="0")
    measured = ElementTree.SubElement(frame, "markers")
    position = {name: k for k, name in enumerate(foreign.points.names)}
    for k, row in enumerate(foreign.control):
        marker = ElementTree.SubElement(markers, "marker", id=str(k), label=row.name)
        if np.isfinite(row.coordinates).all():
            given = {axis: f"{value:.17g}" for axis, value in zip("xyz", row.coordinates, strict=True)}
            given |= {f"s{axis}": f"{_sigma(s):.17g}" for axis, s in zip("xyz", row.sigmas, strict=True)}
            ElementTree.SubElement(marker, "reference", given | {"enabled": "false" if row.check else "true"})
        else:
            losses.append(f"the reference of {row.name}, because one of its coordinates is unknown")
        one = ElementTree.SubElement(measured, "marker", marker_id=str(k))
        for r in np.flatnonzero(foreign.rays.point == position[row.name]).tolist():
            x, y = (f"{value:.17g}" for value in foreign.rays.xy[r])
            ElementTree.SubElement(one, "location", camera_id=str(foreign.rays.image[r]), pinned="true", x=x, y=y)


def _references(path: Path, foreign: ForeignBlock) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for row in foreign.control:
            numbers = [f"{v:.17g}" if np.isfinite(v) else "" for v in (*row.coordinates, *map(_sigma, row.sigmas))]
            writer.writerow([row.name, *numbers, 0 if row.check else 1])


def _sigma(sigma: float) -> float:
    return HELD if sigma == 0 else sigma


def _row(values) -> str:
    return " ".join(f"{value:.17g}" for value in values)
