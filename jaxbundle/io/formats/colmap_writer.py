"""Writing a block as a COLMAP model, binary or text. Rigs and frames are not written: COLMAP makes trivial ones."""

import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.colmap_binary import IMAGE_POINT
from jaxbundle.io.formats.colmap_cameras import colmap_from_camera
from jaxbundle.io.formats.foreign_block import ForeignBlock, RayTable
from jaxbundle.io.formats.misfit import ray_residuals
from jaxbundle.io.formats.written import in_pixels, losses_of_block

GREY = (128, 128, 128)
HOLDS: frozenset[str] = frozenset()


class _Tracks:
    """Order of the rays by image and by point, and the index of each ray within its image."""

    def __init__(self, foreign: ForeignBlock):
        rays = foreign.rays
        order = np.argsort(rays.image, kind="stable")
        self.rays = RayTable(rays.image[order], rays.point[order], rays.xy[order])
        self.starts = np.searchsorted(self.rays.image, np.arange(len(foreign.images.names) + 1))
        self.place = np.arange(len(order)) - self.starts[self.rays.image]
        self.by_point = np.argsort(self.rays.point, kind="stable")
        self.ends = np.searchsorted(self.rays.point[self.by_point], np.arange(len(foreign.points.names) + 1))
        v, _ = ray_residuals(foreign)
        size = np.hypot(*np.nan_to_num(v).T)
        count = np.bincount(rays.point, minlength=len(foreign.points.names))
        self.error = np.bincount(rays.point, size, len(foreign.points.names)) / np.maximum(count, 1)

    def of_point(self, point: int) -> Int[np.ndarray, " ray"]:
        return self.by_point[self.ends[point] : self.ends[point + 1]]


def write_colmap(block: Block, path: Path, *, text: bool = False) -> list[str]:
    """Writes cameras, images and points3D; numbers count from 1 in the order of the block.

    Returns: sentences about what a COLMAP model cannot represent.
    """
    written = in_pixels(block, lambda camera: colmap_from_camera(camera) is not None)
    foreign, tracks = written.foreign, _Tracks(written.foreign)
    turned, translation = rotations.to_camera(foreign.images.rotation, foreign.images.centre)
    poses = np.concatenate([rotations.to_quaternions(turned), translation], 1)
    path.mkdir(parents=True, exist_ok=True)
    for write, name in ((_cameras, "cameras"), (_images, "images"), (_points, "points3D")):
        data = write(foreign, tracks, poses, text)
        (path / f"{name}.{'txt' if text else 'bin'}").write_bytes(data)
    return [*written.losses, *losses_of_block(block, HOLDS)]


def _cameras(foreign: ForeignBlock, tracks: _Tracks, poses: Float[np.ndarray, "image 7"], text: bool) -> bytes:
    rows = []
    for number, camera in enumerate(foreign.cameras, 1):
        found = colmap_from_camera(camera)
        assert found is not None
        model, parameters = found
        width, height = camera.width or 0, camera.height or 0
        if text:
            rows.append(f"{number} {model.name} {width} {height} {_numbers(parameters)}\n".encode())
        else:
            rows.append(struct.pack(f"<IiQQ{len(parameters)}d", number, model.number, width, height, *parameters))
    head = b"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n" if text else struct.pack("<Q", len(rows))
    return head + b"".join(rows)


def _numbers(values) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def _images(foreign: ForeignBlock, tracks: _Tracks, poses: Float[np.ndarray, "image 7"], text: bool) -> bytes:
    rows = []
    for k, name in enumerate(foreign.images.names):
        some = slice(tracks.starts[k], tracks.starts[k + 1])
        xy, point = tracks.rays.xy[some], tracks.rays.point[some] + 1
        camera = int(foreign.images.camera[k]) + 1
        if text:
            rays = " ".join(f"{x:.17g} {y:.17g} {p}" for (x, y), p in zip(xy.tolist(), point.tolist(), strict=True))
            rows.append(f"{k + 1} {_numbers(poses[k])} {camera} {name}\n{rays}\n".encode())
            continue
        data = np.zeros(len(point), IMAGE_POINT)
        data["xy"], data["point"] = xy, point
        head = struct.pack("<I7dI", k + 1, *poses[k], camera)
        rows.append(head + name.encode() + b"\0" + struct.pack("<Q", len(data)) + data.tobytes())
    head = b"# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n"
    return (head if text else struct.pack("<Q", len(rows))) + b"".join(rows)


def _points(foreign: ForeignBlock, tracks: _Tracks, poses: Float[np.ndarray, "image 7"], text: bool) -> bytes:
    rows, image = [], tracks.rays.image + 1
    for k, xyz in enumerate(foreign.points.coordinates.tolist()):
        some = tracks.of_point(k)
        track = np.column_stack([image[some], tracks.place[some]])
        if text:
            told = " ".join(map(str, track.ravel().tolist()))
            grey = " ".join(map(str, GREY))
            rows.append(f"{k + 1} {_numbers(xyz)} {grey} {tracks.error[k]:.17g} {told}\n".encode())
        else:
            head = struct.pack("<Qddd3BdQ", k + 1, *xyz, *GREY, tracks.error[k], len(track))
            rows.append(head + track.astype("<u4").tobytes())
    head = b"# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
    return (head if text else struct.pack("<Q", len(rows))) + b"".join(rows)
