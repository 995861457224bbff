"""Writing a block as an OPF project: JSON files, and tracks as glTF with binary buffers.

The processing frame is reduced by a shift, because positions of tracks are in single precision.
"""

import json
import uuid
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.foreign_block import ForeignBlock, ForeignCamera, element
from jaxbundle.io.formats.gltf import EXTENSION, OFFSET_BITS
from jaxbundle.io.formats.opf import PREFIX, PROJECT, SUFFIX
from jaxbundle.io.formats.written import in_pixels, losses_of_block

LOCAL = (  # for a block without a named system
    'ENGINEERINGCRS["local",EDATUM["local"],CS[Cartesian,3],AXIS["(X)",east,ORDER[1]],AXIS["(Y)",north,ORDER[2]],'
    'AXIS["(Z)",up,ORDER[3]],LENGTHUNIT["metre",1.0]]'
)
NAMES = uuid.UUID("6ba7b811-9dad-11d1-80b4-00c04fd430c8")  # the name space of URLs of RFC 4122
GREY = 128


def _holds(camera: ForeignCamera) -> bool:
    return camera.model is METASHAPE and not any(element(camera, name) for name in ("b1", "b2", "K4"))


def write_opf(block: Block, path: Path) -> list[str]:
    """Writes a project into a folder; control points have their marks, all others are tracks.

    Returns: sentences about what the format cannot represent.
    """
    written = in_pixels(block, _holds)
    foreign = written.foreign
    path.mkdir(parents=True, exist_ok=True)
    shift = -np.round(foreign.images.centre.mean(0))
    system = foreign.coordinate_system or LOCAL
    resources = {
        "camera-list": {"cameras": [{"id": k, "uri": name} for k, name in enumerate(foreign.images.names)]},
        "input-cameras": _inputs(foreign),
        "calibrated-cameras": _calibrated(foreign, shift),
        "input-control-points": _control(foreign, system),
        "constraints": _constraints(foreign),
        "scene-reference-frame": {
            "crs": {"definition": system},
            "base_to_canonical": {"shift": shift.tolist(), "scale": [1.0, 1.0, 1.0], "swap_xy": False},
        },
    }
    items = []
    for name, content in resources.items():
        form = f"{PREFIX}{name}{SUFFIX}"
        (path / f"{name}.json").write_text(json.dumps({"format": form, "version": "1.0", **content}), encoding="utf-8")
        items.append(_item(foreign.name, name.replace("-", "_"), [(f"{name}.json", form)]))
    buffers = _tracks(foreign, path, shift)
    forms = [("tracks.gltf", "model/gltf+json"), *((name, "application/gltf-buffer+bin") for name in buffers)]
    items.append(_item(foreign.name, "point_cloud", forms))
    project = {
        "format": f"{PREFIX}project{SUFFIX}",
        "version": "1.0",
        "id": str(uuid.uuid5(NAMES, foreign.name)),
        "name": foreign.name,
        "description": "",
        "generator": {"name": "jaxbundle", "version": "1"},
        "items": items,
    }
    (path / PROJECT).write_text(json.dumps(project, indent=1), encoding="utf-8")
    losses = ["names of tie points; their coordinates are in single precision"]
    return [*written.losses, *losses, *losses_of_block(block, frozenset({"control", "distances"}))]


def _item(block: str, kind: str, files: list[tuple[str, str]]) -> dict[str, Any]:
    resources = [{"uri": uri, "format": form} for uri, form in files]
    number = str(uuid.uuid5(NAMES, f"{block}/{kind}"))
    return {"id": number, "type": kind, "resources": resources, "sources": []}


def _internals(camera: ForeignCamera) -> dict[str, Any]:
    return {
        "type": "perspective",
        "principal_point_px": [element(camera, "x0"), element(camera, "y0")],
        "focal_length_px": element(camera, "principal_distance"),
        "radial_distortion": [element(camera, name) for name in ("K1", "K2", "K3")],
        "tangential_distortion": [element(camera, "P2"), element(camera, "P1")],
    }


def _inputs(foreign: ForeignBlock) -> dict[str, Any]:
    sensors = [
        {
            "id": k,
            "name": camera.name,
            "bands": [{"name": "Gray", "weight": 1.0}],
            "image_size_px": [camera.width, camera.height],
            "internals": _internals(camera),
            "shutter_type": "global",
        }
        for k, camera in enumerate(foreign.cameras)
    ]
    captures = [
        {
            "id": k,
            "reference_camera_id": k,
            "cameras": [
                {
                    "id": k,
                    "sensor_id": int(camera),
                    "model_source": "user",
                    "pixel_type": "uint8",
                    "pixel_range": {"min": 0, "max": 255},
                }
            ],
        }
        for k, camera in enumerate(foreign.images.camera)
    ]
    return {"sensors": sensors, "captures": captures}


def _calibrated(foreign: ForeignBlock, shift: Float[np.ndarray, "3"]) -> dict[str, Any]:
    angles = np.degrees(rotations.to_angles(foreign.images.rotation)).tolist()
    places = (foreign.images.centre + shift).tolist()
    cameras = [
        {"id": k, "sensor_id": int(camera), "position": places[k], "orientation_deg": angles[k]}
        for k, camera in enumerate(foreign.images.camera)
    ]
    sensors = [{"id": k, "internals": _internals(camera)} for k, camera in enumerate(foreign.cameras)]
    return {"sensors": sensors, "cameras": cameras}


def _control(foreign: ForeignBlock, system: str) -> dict[str, Any]:
    rays, sigma = foreign.rays, foreign.rays.sigma
    marks: dict[int, list[dict[str, Any]]] = {}
    for r in range(len(rays.image)):
        accuracy = 1.0 if sigma is None else float(sigma[r])
        mark = {"camera_id": int(rays.image[r]), "position_px": rays.xy[r].tolist(), "accuracy": accuracy}
        marks.setdefault(int(rays.point[r]), []).append(mark)
    position = {name: k for k, name in enumerate(foreign.points.names)}
    gcps = [
        {
            "id": row.name,
            "geolocation": {
                "crs": {"definition": system},
                "coordinates": list(row.coordinates),
                "sigmas": [value if value > 0 else 1e-6 for value in row.sigmas],
            },
            "marks": marks.get(position[row.name], []),
            "is_checkpoint": row.check,
        }
        for row in _complete(foreign)
    ]
    return {"gcps": gcps, "mtps": []}


def _complete(foreign: ForeignBlock):
    """Control points with three known coordinates."""
    return [row for row in foreign.control if np.isfinite([*row.coordinates, *row.sigmas]).all()]


def _constraints(foreign: ForeignBlock) -> dict[str, Any]:
    rows = [
        {"id": f"distance {k}", "id_from": row.start, "id_to": row.end, "distance": row.distance, "sigma": row.sigma}
        for k, row in enumerate(foreign.distances)
    ]
    return {"scale_constraints": rows, "orientation_constraints": []}


def _tracks(foreign: ForeignBlock, path: Path, shift: Float[np.ndarray, "3"]) -> list[str]:
    """Writes tracks.gltf and its buffers, and returns their names."""
    control = {row.name for row in _complete(foreign)}
    tie = np.array([name not in control for name in foreign.points.names], bool)
    number = np.cumsum(tie) - 1
    wanted = np.flatnonzero(tie[foreign.rays.point])
    order = wanted[np.argsort(foreign.rays.point[wanted], kind="stable")]
    point = number[foreign.rays.point[order]]
    count = np.bincount(point, minlength=int(tie.sum())).astype(np.uint64)
    start = np.cumsum(count) - count
    ranges = (start | (count << np.uint64(OFFSET_BITS))).astype("<u8")
    positions = (foreign.points.coordinates[tie] + shift).astype("<f4")
    arrays = {
        "positions.bin": (positions, 5126, "VEC3"),
        "colors.bin": (np.full((len(positions), 4), GREY, "u1"), 5121, "VEC4"),
        "matchCameraIds.bin": (foreign.rays.image[order].astype("<u4"), 5125, "SCALAR"),
        "matchPointIndexRanges.bin": (ranges, 5125, "VEC2"),
        "matchPixelCoordinates.bin": (foreign.rays.xy[order].astype("<f4"), 5126, "VEC2"),
        "matchFeatureIds.bin": (np.arange(len(order)).astype("<u4"), 5125, "SCALAR"),
        "matchScales.bin": (np.ones(len(order), "<f4"), 5126, "SCALAR"),
    }
    accessors, views, buffers = [], [], []
    for k, (name, (data, component, kind)) in enumerate(arrays.items()):
        (path / name).write_bytes(data.tobytes())
        rows = len(data)
        buffers.append({"uri": name, "byteLength": data.nbytes})
        views.append({"buffer": k, "byteOffset": 0, "byteLength": data.nbytes})
        accessors.append({"bufferView": k, "componentType": component, "count": rows, "type": kind})
    accessors[1]["normalized"] = True
    if len(positions):
        accessors[0] |= {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
    matches = {
        "cameraUids": list(range(len(foreign.images.names))),
        "cameraIds": 2,
        "pointIndexRanges": 3,
        "imagePoints": {"pixelCoordinates": 4, "featureIds": 5, "scales": 6},
    }
    primitive = {"attributes": {"POSITION": 0, "COLOR_0": 1}, "mode": 0, "extensions": {EXTENSION: matches}}
    content = {
        "asset": {"version": "2.0", "extensions": {"OPF_asset_version": {"version": "1.0"}}},
        "extensionsUsed": ["OPF_asset_version", EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": [1.0, 0, 0, 0, 0, 0, -1.0, 0, 0, 1.0, 0, 0, 0, 0, 0, 1.0]}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": buffers,
    }
    (path / "tracks.gltf").write_text(json.dumps(content), encoding="utf-8")
    return list(arrays)
