"""Tracks of an OPF project: a glTF file whose mesh has matches of image points (OPF_mesh_primitive_matches)."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.io.formats.source import json_of, wrong
from jaxbundle.io.text_files import require_bytes

EXTENSION = "OPF_mesh_primitive_matches"
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
OFFSET_BITS = 40  # of a range of 64 bits: first ray, then number of rays
CURE = "export the project again"


class Tracks(NamedTuple):
    """Points in the processing frame, and their rays; `lost`: number of rays on unknown images."""

    points: Float[np.ndarray, "point 3"]
    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    xy: Float[np.ndarray, "ray 2"]
    lost: int


def read_tracks(path: Path, images: dict[int, int]) -> Tracks | None:
    """Reads the tracks of a file; None where it has no matches. `images`: numbers of images by their id.

    Raises: BlockError where the file is incomplete.
    """
    content = json_of(path)
    try:
        primitives = [one for mesh in content["meshes"] for one in mesh["primitives"]]
        found = next((one for one in primitives if EXTENSION in one.get("extensions", {})), None)
        with np.errstate(all="ignore"):  # values that are not finite are reported below
            return None if found is None else _tracks(path, content, found, images)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, OverflowError) as error:
        if isinstance(error, ValueError) and hasattr(error, "problems"):
            raise
        raise wrong(
            path, 0, f"the tracks are not complete ({type(error).__name__}: {str(error)[:60]})", CURE
        ) from error


def _tracks(path: Path, content: Any, primitive: Any, images: dict[int, int]) -> Tracks:
    matches = primitive["extensions"][EXTENSION]
    points = _upright(content, _array(path, content, primitive["attributes"]["POSITION"]).astype(float))
    camera = _array(path, content, matches["cameraIds"])[:, 0].astype(np.int64)
    ranges = np.ascontiguousarray(_array(path, content, matches["pointIndexRanges"])).view("<u8").ravel()
    start, count = ranges & np.uint64(2**OFFSET_BITS - 1), ranges >> np.uint64(OFFSET_BITS)
    start, count = start.astype(np.int64), count.astype(np.int64)
    xy = _array(path, content, matches["imagePoints"]["pixelCoordinates"]).astype(float)
    uids = np.array([images.get(int(uid), -1) for uid in matches["cameraUids"]], np.int64)
    if len(start) != len(points) or ((start + count) > len(camera)).any() or len(xy) != len(camera):
        raise wrong(path, 0, "the numbers of points, ranges and image points differ", CURE)
    if (camera >= len(uids)).any() or not np.isfinite(points).all() or not np.isfinite(xy).all():
        raise wrong(path, 0, "a ray refers to a missing camera, or has coordinates that are not finite", CURE)
    ray = np.repeat(start - (np.cumsum(count) - count), count) + np.arange(count.sum())
    point, image = np.repeat(np.arange(len(points)), count), uids[camera[ray]]
    known = image >= 0
    return Tracks(points, image[known], point[known], xy[ray][known], int((~known).sum()))


def _upright(content: Any, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
    """The points of a node with y up, transformed by its matrix, with z up."""
    matrix = np.eye(4)
    for node in content.get("nodes", []):
        if "mesh" in node and "matrix" in node:
            matrix = np.array(node["matrix"], float).reshape(4, 4).T
    placed = points @ matrix[:3, :3].T + matrix[:3, 3]
    up = np.column_stack([placed[:, 0], -placed[:, 2], placed[:, 1]])
    return up


def _array(path: Path, content: Any, number: int) -> np.ndarray:
    """The rows of one accessor."""
    accessor = content["accessors"][number]
    view = content["bufferViews"][accessor["bufferView"]]
    uri = content["buffers"][view["buffer"]]["uri"]
    if ".." in Path(uri).parts or Path(uri).is_absolute():
        raise wrong(path, 0, "a buffer is outside the project", CURE)
    data = require_bytes(path.parent / uri)
    kind, size, count = (
        np.dtype("<" + COMPONENTS[accessor["componentType"]]),
        SIZES[accessor["type"]],
        accessor["count"],
    )
    at = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    if at < 0 or count < 0 or at + count * size * kind.itemsize > len(data):
        raise wrong(path, 0, f"{uri} ends before its {count} rows", CURE)
    return np.frombuffer(data, kind, count * size, at).reshape(count, size)
