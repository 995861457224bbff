"""Reading the text files of a COLMAP model."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.problems import shown
from jaxbundle.io.formats.colmap_records import NO_POSE, CameraRecord, FrameRecord, Model, SensorRecord, model_of
from jaxbundle.io.formats.source import AGAIN, MAX_NUMBER, integer, lines_of, numbers
from jaxbundle.io.noted import Noted

NAME_FIELD = 9  # of an image line: the name is the last field and may contain blanks
SENSORS = {"CAMERA": 0, "IMU": 1}


def read_text_model(folder: Path, noted: Noted) -> Model:
    """Reads the records of cameras.txt, images.txt, points3D.txt and, if they exist, rigs.txt and frames.txt."""
    images, rays = _images(folder / "images.txt", noted)
    return model_of(
        _cameras(folder / "cameras.txt", noted),
        images,
        rays,
        _points(folder / "points3D.txt", noted),
        (_rigs(folder / "rigs.txt", noted), _frames(folder / "frames.txt", noted)),
    )


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Fields of the lines that are neither empty nor a comment."""
    if not path.exists():
        return
    for line, text in enumerate(lines_of(path), 1):
        if text.strip() and not text.lstrip().startswith("#"):
            yield line, text.split()


def _cameras(path: Path, noted: Noted) -> list[CameraRecord]:
    cameras = []
    for line, fields in _rows(path):
        if len(fields) < 5:
            noted.add(path.name, line, f"the camera has {len(fields)} fields, too few", AGAIN)
            continue
        whole = [integer(path, line, fields[k], noted, "the field") for k in (0, 2, 3)]
        values = numbers(path, line, fields[4:], noted)
        if values is not None and None not in whole:
            number, width, height = (k for k in whole if k is not None)
            cameras.append(CameraRecord(number, fields[1], width, height, tuple(values), line))
    return cameras


def _images(
    path: Path, noted: Noted
) -> tuple[list[tuple[int, str, int, list[float]]], list[tuple[np.ndarray, np.ndarray]]]:
    """Images and their rays: two lines each; the second may be empty."""
    images, rays = [], []
    lines = lines_of(path)
    k = 0
    while k < len(lines):
        text = lines[k]
        k += 1
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        fields = text.split(None, NAME_FIELD)
        if len(fields) <= NAME_FIELD:
            noted.add(path.name, k, f"the image has {len(fields)} fields, not {NAME_FIELD + 1}", AGAIN)
            continue
        number = integer(path, k, fields[0], noted, "the number of the image")
        camera = integer(path, k, fields[8], noted, "the number of the camera")
        pose = numbers(path, k, fields[1:8], noted)
        found = _image_points(path, k + 1, lines[k] if k < len(lines) else "", noted)
        k += 1
        if number is not None and camera is not None and pose is not None and found is not None:
            images.append((number, fields[9].strip(), camera, pose))
            rays.append(found)
    return images, rays


def _image_points(
    path: Path, line: int, text: str, noted: Noted
) -> tuple[Float[np.ndarray, "ray 2"], Int[np.ndarray, " ray"]] | None:
    """Image points of a line that belong to an object point."""
    try:
        values = np.array(text.split(), float)
    except ValueError:
        values = np.array([np.nan])
    if len(values) % 3 or not (np.abs(values) < MAX_NUMBER).all():
        what = f"the image points '{shown(text.strip(), 30)}' are not triples of numbers x, y, point"
        noted.add(path.name, line, what, AGAIN)
        return None
    rows = values.reshape(-1, 3)
    rows = rows[rows[:, 2] >= 0]
    return rows[:, :2], rows[:, 2].astype(np.int64)


def _points(path: Path, noted: Noted) -> tuple[Int[np.ndarray, " point"], Float[np.ndarray, "point 3"]]:
    rows = list(_rows(path))
    short = [line for line, fields in rows if len(fields) < 8]
    if short:
        noted.add_rows(path.name, short, "the point has too few fields", AGAIN)
        return np.zeros(0, np.int64), np.zeros((0, 3))
    try:
        ids = np.array([int(fields[0]) for _, fields in rows], np.int64)
        coordinates = np.array([fields[1:4] for _, fields in rows], float).reshape(-1, 3)
        if (np.abs(coordinates) < MAX_NUMBER).all():
            return ids, coordinates
    except (ValueError, OverflowError):
        pass
    for line, fields in rows:
        integer(path, line, fields[0], noted, "the number of the point")
        numbers(path, line, fields[1:4], noted)
    return np.zeros(0, np.int64), np.zeros((0, 3))


def _rigs(path: Path, noted: Noted) -> dict[int, list[SensorRecord]]:
    rigs: dict[int, list[SensorRecord]] = {}
    for line, fields in _rows(path):
        try:
            rig, count = int(fields[0]), int(fields[1])
            sensors = [SensorRecord((SENSORS[fields[2]], int(fields[3])), NO_POSE)] if count else []
            at = 4
            for _ in range(count - 1):
                key, has_pose = (SENSORS[fields[at]], int(fields[at + 1])), fields[at + 2] == "1"
                at += 3
                if has_pose:
                    sensors.append(SensorRecord(key, _pose(fields[at : at + 7])))
                    at += 7
            rigs[rig] = sensors
        except (ValueError, IndexError, KeyError):
            noted.add(path.name, line, "this is not a rig: number, sensors, and a pose of each", AGAIN)
    return rigs


def _frames(path: Path, noted: Noted) -> list[FrameRecord]:
    frames = []
    for line, fields in _rows(path):
        try:
            data = [
                ((SENSORS[fields[k]], int(fields[k + 1])), int(fields[k + 2]))
                for k in range(10, 10 + 3 * int(fields[9]), 3)
            ]
            frames.append(FrameRecord(int(fields[1]), _pose(fields[2:9]), tuple(data)))
        except (ValueError, IndexError, KeyError):
            noted.add(path.name, line, "this is not a frame: number, rig, pose and data of the sensors", AGAIN)
    return frames


def _pose(fields: list[str]) -> Float[np.ndarray, "7"]:
    pose = np.array(fields, float)
    if len(pose) != 7 or not np.isfinite(pose).all() or not pose[:4].any():
        raise ValueError("no pose")
    return pose
