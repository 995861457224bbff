"""Writing maps: GeoJSON and KML in longitude and latitude, GeoPackage in the system of the block.

GeoJSON (RFC 7946) and KML use WGS 84 only, so the system of the block must be known. Error ellipses and residual
vectors are enlarged by the factor in their rows.
"""

import json
import math
import struct
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float

from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.io.formats.coordinates import crs_of, is_metric_local, transformed
from jaxbundle.io.formats.extras import extra
from jaxbundle.io.results.map_features import Features
from jaxbundle.io.results.system import system_of

WGS84 = "EPSG:4979"
CORNERS = 36  # vertices of a drawn ellipse
POINT, LINE, POLYGON = "Point", "LineString", "Polygon"
WKB = {POINT: 1001, LINE: 1002, POLYGON: 1003}  # with heights


class Layer(NamedTuple):
    """Rows of one kind of geometry: the coordinates of each, and columns of attributes."""

    name: str
    geometry: str
    shapes: list[Float[np.ndarray, "_corner 3"]]
    columns: dict[str, list[Any]]


def layers_of(features: Features) -> list[Layer]:
    """Layers of points, images, residuals and ellipses, if there are any."""
    s = features.block.structure
    columns: dict[str, list[Any]] = {"point": list(s.point_names), "rays": features.rays.tolist()}
    if features.sigmas is not None:
        columns |= {name: features.sigmas[:, k].tolist() for k, name in enumerate(("sX", "sY", "sZ"))}
    layers = [Layer("points", POINT, list(features.points[:, None]), columns)]
    angles = np.degrees(features.angles)
    images: dict[str, list[Any]] = {"image": list(s.image_names)}
    images |= {name: angles[:, k].tolist() for k, name in enumerate(s.rotation_system.angles)}
    layers.append(Layer("images", POINT, list(features.centres[:, None]), images))
    vectors, scale = features.vectors, features.vector_scale
    if vectors.names:
        ends = vectors.start + vectors.residual * scale
        shapes = [np.stack([a, b]) for a, b in zip(vectors.start, ends, strict=True)]
        table: dict[str, list[Any]] = {"point": list(vectors.names)}
        table |= {f"d{axis}": vectors.residual[:, k].tolist() for k, axis in enumerate("XYZ")}
        layers.append(Layer("residuals", LINE, shapes, {**table, "scale": [scale] * len(shapes)}))
    if features.ellipses is not None:
        layers.append(_ellipses(features))
    return layers


def outline(features: Features, point: int) -> Float[np.ndarray, "corner 3"]:
    """The enlarged error ellipse of a point, as a closed line."""
    assert features.ellipses is not None
    (a, b), direction = features.ellipses.axes[point] * features.ellipse_scale, features.ellipses.direction[point]
    t = np.linspace(0, 2 * math.pi, CORNERS + 1)
    x, y = a * np.cos(t), b * np.sin(t)
    c, s = math.cos(direction), math.sin(direction)
    corners = np.stack([c * x - s * y, s * x + c * y, np.zeros_like(t)], -1) + features.points[point]
    corners[-1] = corners[0]
    return corners


def _ellipses(features: Features) -> Layer:
    assert features.ellipses is not None
    axes, names = features.ellipses.axes, features.block.structure.point_names
    drawn = np.flatnonzero((axes > 0).all(1)).tolist()
    return Layer(
        "ellipses",
        POLYGON,
        [outline(features, k) for k in drawn],
        {
            "point": [names[k] for k in drawn],
            "a": axes[drawn, 0].tolist(),
            "b": axes[drawn, 1].tolist(),
            "direction": np.degrees(features.ellipses.direction[drawn]).tolist(),
            "scale": [features.ellipse_scale] * len(drawn),
        },
    )


def _on_earth(features: Features, path: Path) -> list[Layer]:
    """All layers in longitude, latitude and height.

    Raises: BlockError where the system of the block is unknown.
    """
    system = system_of(features.block)
    if not system or is_metric_local(system) or system.startswith("topocentric"):
        what = f"{path.name} needs longitude and latitude, and the coordinate system of the block is unknown"
        cure = "write .gpkg, .dxf or .ply instead, or write 'coordinate system: EPSG:n' in source of block.toml"
        raise BlockError([Problem(what, cure)])

    def moved(layer: Layer) -> Layer:
        counts = [len(shape) for shape in layer.shapes]
        together = np.concatenate(layer.shapes) if layer.shapes else np.zeros((0, 3))
        found = transformed(system, WGS84, together) if len(together) else together
        return layer._replace(shapes=np.split(found, np.cumsum(counts)[:-1]) if counts else [])

    return [moved(layer) for layer in layers_of(features)]


def write_geojson(features: Features, path: Path) -> None:
    """Writes all layers as one collection of features, each with the name of its layer.

    Raises: BlockError where pyproj is not installed or the system of the block is not known.
    """
    rows = []
    for layer in _on_earth(features, path):
        for k, shape in enumerate(layer.shapes):
            places: Any = shape.tolist()
            coordinates = {POINT: lambda p: p[0], LINE: lambda p: p, POLYGON: lambda p: [p]}[layer.geometry](places)
            properties = {"layer": layer.name, **{name: column[k] for name, column in layer.columns.items()}}
            geometry = {"type": layer.geometry, "coordinates": coordinates}
            rows.append({"type": "Feature", "geometry": geometry, "properties": properties})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": rows}), encoding="utf-8")


def write_kml(features: Features, path: Path) -> None:
    """Writes all layers as folders, heights absolute.

    Raises: BlockError where pyproj is not installed or the system of the block is not known.
    """
    parts = ['<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n']
    for layer in _on_earth(features, path):
        parts.append(f"<Folder><name>{layer.name}</name>\n")
        names = next(iter(layer.columns.values()))
        for name, shape in zip(names, layer.shapes, strict=True):
            places = " ".join(f"{x:.10f},{y:.10f},{z:.4f}" for x, y, z in shape.tolist())
            inside = f"<altitudeMode>absolute</altitudeMode><coordinates>{places}</coordinates>"
            if layer.geometry == POLYGON:
                inside = (
                    "<altitudeMode>absolute</altitudeMode><outerBoundaryIs><LinearRing>"
                    f"<coordinates>{places}</coordinates></LinearRing></outerBoundaryIs>"
                )
            shown = f"<{layer.geometry}>{inside}</{layer.geometry}>"
            parts.append(f"<Placemark><name>{escape(str(name))}</name>{shown}</Placemark>\n")
        parts.append("</Folder>\n")
    path.write_text("".join([*parts, "</Document></kml>\n"]), encoding="utf-8")


def _wkb(geometry: str, shape: Float[np.ndarray, "corner 3"]) -> bytes:
    """Well-known binary, little endian, with heights."""
    head = struct.pack("<BI", 1, WKB[geometry])
    body = shape.astype("<f8").tobytes()
    if geometry == POINT:
        return head + body
    count = struct.pack("<I", len(shape))
    return head + (struct.pack("<I", 1) if geometry == POLYGON else b"") + count + body


def write_geopackage(features: Features, path: Path) -> None:
    """Writes each layer as a table, in the system of the block where it is known.

    Raises: BlockError where pyogrio is not installed.
    """
    pyogrio = extra("pyogrio.raw", f"writing {path.name}")
    system = system_of(features.block)
    crs = crs_of(system).to_wkt() if system and not is_metric_local(system) and "topocentric" not in system else None
    for number, layer in enumerate(layer for layer in layers_of(features) if layer.shapes):
        shapes = np.array([_wkb(layer.geometry, shape) for shape in layer.shapes], object)
        columns = [
            np.array(column, object if isinstance(column[0], str) else None) for column in layer.columns.values()
        ]
        more = {"append": True} if number else {}
        pyogrio.write(
            str(path),
            shapes,
            columns,
            list(layer.columns),
            layer=layer.name,
            driver="GPKG",
            geometry_type=f"{layer.geometry} Z",
            crs=crs,
            promote_to_multi=False,
            **more,
        )
