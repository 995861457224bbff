"""Types of the records of a COLMAP model, shared by text and binary files."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

SensorKey = tuple[int, int]
"""Type of a sensor, 0 for a camera and 1 for an inertial unit, and its number."""


class CameraRecord(NamedTuple):
    """A camera as in the file; `model` is a name or a number, `line` 0 in a binary file."""

    id: int
    model: str | int
    width: int
    height: int
    parameters: tuple[float, ...]
    line: int = 0


class SensorRecord(NamedTuple):
    """A sensor of a rig: quaternion and translation sensor_from_rig."""

    key: SensorKey
    pose: Float[np.ndarray, "7"]


class FrameRecord(NamedTuple):
    """A frame: quaternion and translation rig_from_object, and the images that belong to its sensors."""

    rig: int
    pose: Float[np.ndarray, "7"]
    data: tuple[tuple[SensorKey, int], ...]


class Model(NamedTuple):
    """All records; `ray_point` are numbers of points as in the files."""

    cameras: tuple[CameraRecord, ...]
    image_ids: Int[np.ndarray, " image"]
    image_names: tuple[str, ...]
    image_camera: Int[np.ndarray, " image"]
    quaternion: Float[np.ndarray, "image 4"]
    translation: Float[np.ndarray, "image 3"]
    ray_image: Int[np.ndarray, " ray"]
    ray_point: Int[np.ndarray, " ray"]
    xy: Float[np.ndarray, "ray 2"]
    point_ids: Int[np.ndarray, " point"]
    coordinates: Float[np.ndarray, "point 3"]
    rigs: dict[int, list[SensorRecord]]
    frames: list[FrameRecord]


NO_POSE = np.array([1.0, 0, 0, 0, 0, 0, 0])  # of the reference sensor


def model_of(
    cameras: list[CameraRecord],
    images: list[tuple[int, str, int, list[float]]],
    rays: list[tuple[Float[np.ndarray, "_ray 2"], Int[np.ndarray, " _ray"]]],
    points: tuple[Int[np.ndarray, " point"], Float[np.ndarray, "point 3"]],
    rigs: tuple[dict[int, list[SensorRecord]], list[FrameRecord]],
) -> Model:
    """Joins the records: images as (number, name, camera, quaternion and translation), and rays of each image."""
    pose = np.array([row[3] for row in images], float).reshape(-1, 7)
    counts = [len(point) for _, point in rays]
    return Model(
        tuple(cameras),
        np.array([row[0] for row in images], np.int64),
        tuple(row[1] for row in images),
        np.array([row[2] for row in images], np.int64),
        pose[:, :4],
        pose[:, 4:],
        np.repeat(np.arange(len(images)), counts),
        np.concatenate([point for _, point in rays]) if rays else np.zeros(0, np.int64),
        np.concatenate([xy for xy, _ in rays]) if rays else np.zeros((0, 2)),
        *points,
        *rigs,
    )
