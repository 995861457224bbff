"""Binary files of a COLMAP model, little endian. Each file is one buffer; image points are arrays in that buffer."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.problems import BlockError
from jaxbundle.io.formats.colmap_cameras import BY_NUMBER, READ
from jaxbundle.io.formats.colmap_records import NO_POSE, CameraRecord, FrameRecord, Model, SensorRecord, model_of
from jaxbundle.io.formats.source import MAX_NUMBER, wrong
from jaxbundle.io.noted import Noted
from jaxbundle.io.text_files import require_bytes

IMAGE_POINT = np.dtype([("xy", "<f8", 2), ("point", "<u8")])
NO_POINT = 2**63  # and above: COLMAP's -1
Part = TypeVar("Part")
CUT = "the file is truncated or damaged: copy or export it again"


class _Buffer:
    """A file and a position in it. Content that does not fit raises a BlockError with the byte."""

    def __init__(self, path: Path):
        self.path, self.data, self.at = path, require_bytes(path), 0

    def wrong(self, what: str, cure: str = CUT) -> BlockError:
        return wrong(self.path, 0, f"{what} (byte {self.at} of {len(self.data)})", cure)

    def read(self, form: str, what: str) -> tuple:
        size = struct.calcsize(form)
        if self.at + size > len(self.data):
            raise self.wrong(f"the file ends within {what}")
        values = struct.unpack_from(form, self.data, self.at)
        self.at += size
        return values

    def count(self, least: int, what: str) -> int:
        """Reads the number of records; each has at least the given number of bytes."""
        (count,) = self.read("<Q", f"the number of {what}")
        if count * least > len(self.data) - self.at:
            raise self.wrong(f"there are {count} {what}, more than the rest of the file can contain")
        return count

    def pose(self, what: str) -> list[float]:
        values = list(self.read("<7d", what))
        if not all(abs(value) < MAX_NUMBER for value in values):
            raise self.wrong(f"the pose of {what} has a number that is not finite")
        return values

    def finish(self) -> None:
        if self.at != len(self.data):
            raise self.wrong(f"{len(self.data) - self.at} bytes follow the last record")


def read_binary(folder: Path, noted: Noted) -> Model:
    """Reads the records of cameras.bin, images.bin, points3D.bin and, if they exist, rigs.bin and frames.bin."""
    cameras = _noted(_cameras, folder / "cameras.bin", noted)
    images = _noted(_images, folder / "images.bin", noted)
    points = _noted(_points, folder / "points3D.bin", noted)
    rigs = _noted(_rigs, folder / "rigs.bin", noted) if (folder / "rigs.bin").is_file() else {}
    frames = _noted(_frames, folder / "frames.bin", noted) if (folder / "frames.bin").is_file() else []
    if cameras is None or images is None or points is None or rigs is None or frames is None:
        raise noted.error()
    return model_of(cameras, *images, points, (rigs, frames))


def _noted(read: Callable[[Path], Part], path: Path, noted: Noted) -> Part | None:
    """The content of a file; None and a note where it is damaged."""
    try:
        return read(path)
    except BlockError as error:
        noted.files.append(path.name)
        for problem in error.problems:
            noted.add_problem(path.name if problem.table else "", 0, problem)
        return None


def _cameras(path: Path) -> list[CameraRecord]:
    file, cameras = _Buffer(path), []
    for _ in range(file.count(24, "cameras")):
        number, model, width, height = file.read("<IiQQ", "a camera")
        if model not in BY_NUMBER:
            raise file.wrong(f"camera {number} has the unknown model {model}", f"read are {READ}")
        parameters = file.read(f"<{len(BY_NUMBER[model].parameters)}d", f"camera {number}")
        if not all(abs(value) < MAX_NUMBER for value in parameters):
            raise file.wrong(f"camera {number} has a parameter that is not a finite number")
        cameras.append(CameraRecord(number, model, width, height, parameters))
    file.finish()
    return cameras


def _images(path: Path) -> tuple[list, list]:
    file, images, rays = _Buffer(path), [], []
    for _ in range(file.count(73, "images")):
        (number,) = file.read("<I", "an image")
        pose = file.pose(f"image {number}")
        (camera,) = file.read("<I", f"image {number}")
        end = file.data.find(b"\0", file.at)
        if end < 0:
            raise file.wrong(f"the name of image {number} does not end")
        name = file.data[file.at : end].decode("utf-8", "replace")
        file.at = end + 1
        count = file.count(IMAGE_POINT.itemsize, f"image points of image {number}")
        rows = np.frombuffer(file.data, IMAGE_POINT, count, file.at)
        file.at += count * IMAGE_POINT.itemsize
        rows = rows[rows["point"] < NO_POINT]
        if not (np.abs(rows["xy"]) < MAX_NUMBER).all():
            raise file.wrong(f"image {number} has an image point that is not finite")
        images.append((number, name, camera, pose))
        rays.append((rows["xy"].copy(), rows["point"].astype(np.int64)))
    file.finish()
    return images, rays


def _points(path: Path) -> tuple[Int[np.ndarray, " point"], Float[np.ndarray, "point 3"]]:
    file = _Buffer(path)
    count = file.count(51, "points")
    ids, coordinates = np.zeros(count, np.int64), np.zeros((count, 3))
    head, size, at, data = struct.Struct("<Qddd3sdQ"), struct.calcsize("<Qddd3sdQ"), file.at, file.data
    for k in range(count):
        if at + size > len(data):
            file.at = at
            raise file.wrong(f"the file ends within point {k + 1} of {count}")
        number, x, y, z, _, _, track = head.unpack_from(data, at)
        if number >= NO_POINT or track > len(data):
            file.at = at
            raise file.wrong(f"point {k + 1} of {count} has an impossible number or length of track")
        ids[k], coordinates[k] = number, (x, y, z)
        at += size + 8 * track
    file.at = at
    if at > len(data):
        raise file.wrong(f"the file ends in the track of point {count}")
    file.finish()
    if not (np.abs(coordinates) < MAX_NUMBER).all():
        raise file.wrong("a point has a coordinate that is not a finite number")
    return ids, coordinates


def _rigs(path: Path) -> dict[int, list[SensorRecord]]:
    file, rigs = _Buffer(path), {}
    for _ in range(file.count(8, "rigs")):
        rig, sensors = file.read("<II", "a rig")
        rows: list[SensorRecord] = []
        if sensors:
            kind, number = file.read("<iI", f"rig {rig}")
            rows.append(SensorRecord((kind, number), NO_POSE))
        for _ in range(sensors - 1):
            kind, number, has_pose = file.read("<iIB", f"rig {rig}")
            if has_pose:
                rows.append(SensorRecord((kind, number), _pose(file, f"rig {rig}")))
        rigs[rig] = rows
    file.finish()
    return rigs


def _frames(path: Path) -> list[FrameRecord]:
    file, frames = _Buffer(path), []
    for _ in range(file.count(68, "frames")):
        number, rig = file.read("<II", "a frame")
        pose = _pose(file, f"frame {number}")
        (count,) = file.read("<I", f"frame {number}")
        data = []
        for _ in range(count):
            kind, sensor, image = file.read("<iIQ", f"frame {number}")
            data.append(((kind, sensor), image))
        frames.append(FrameRecord(rig, pose, tuple(data)))
    file.finish()
    return frames


def _pose(file: _Buffer, what: str) -> Float[np.ndarray, "7"]:
    pose = np.array(file.pose(what))
    if not pose[:4].any():
        raise file.wrong(f"the quaternion of {what} is 0")
    return pose
