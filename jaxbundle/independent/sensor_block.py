"""Converting a block of photographs to a block of sensors (models or strips) that measure three coordinates."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import (
    Block,
    Camera,
    CheckPoints,
    Datum,
    ExteriorOrientation,
    InteriorOrientation,
    Rays,
    Structure,
)
from jaxbundle.block.findings import Finding
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.camera.model import CameraModel
from jaxbundle.independent.translated import Stand, translated
from jaxbundle.numerics.host import on_device

CENTRE = "centre of "  # prefix of the name of an image for the object point at its projection centre


class Seen(NamedTuple):
    """Points measured by sensors: object points and projection centres."""

    sensor: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    """Index of the point in the photographs, or number of points + image index for a projection centre."""
    coordinates: Float[np.ndarray, "ray 3"]
    covariances: Float[np.ndarray, "ray 3 3"]
    """Covariances of single points."""
    shared: Float[np.ndarray, "ray 3 5"]
    """Derivatives with respect to common errors of all points of a sensor."""


class Sensors(NamedTuple):
    """Models or strips: names, sensor model, and approximate orientations."""

    names: tuple[str, ...]
    model: CameraModel
    centres: Float[np.ndarray, "sensor 3"]
    angles: Float[np.ndarray, "sensor 3"]
    exterior_free: Bool[np.ndarray, "sensor 6"]
    interior: Float[np.ndarray, "sensor element"]
    of_image: Int[np.ndarray, " image"]
    """The sensor for the attitude of each image; -1 without one."""
    rotation: Float[np.ndarray, "image 3 3"]
    """Matrix sensor_from_image."""


class SensorBlock(NamedTuple):
    """The block of sensors, and its relation to the block of photographs."""

    block: Block
    sensors: Sensors
    points: Int[np.ndarray, " new"]
    """Indices of the points in the photographs; the projection centres follow."""
    images: Int[np.ndarray, " centre"]
    """Images of the projection centres, in this order."""
    findings: tuple[Finding, ...]


def sensor_block(
    block: Block,
    seen: Seen,
    numbers: Float[np.ndarray, "ray number"],
    sensors: Sensors,
    more: tuple[ObservationGroup, ...],
) -> SensorBlock:
    """Makes the block of these sensors; points, control and other observations are those of the photographs.

    `numbers`: measurements of each ray of a sensor; its residuals have standard deviation 1. `more`: further groups.
    """
    s, count = block.structure, len(block.structure.point_names)
    taking_part = np.unique(seen.point)
    number = np.full(count + len(s.image_names), -1, np.int32)
    number[taking_part] = np.arange(len(taking_part))
    points, images = taking_part[taking_part < count], taking_part[taking_part >= count] - count
    stand = Stand(number[:count], number[count:], sensors.of_image, sensors.rotation)
    groups, told = translated(block.groups, {"point": s.point_names, "image": s.image_names}, stand)
    check = stand.point[s.check_point] >= 0
    structure = Structure(
        name=s.name,
        # TRAP: coordinates of sensors are in the object unit; a camera can have px or mm only
        cameras=tuple(Camera(name, sensors.model, "mm") for name in sensors.names),
        image_names=sensors.names,
        point_names=tuple([s.point_names[p] for p in points] + _centre_names(block, images)),
        image_camera=np.arange(len(sensors.names), dtype=np.int32),
        ray_image=seen.sensor.astype(np.int32),
        ray_point=number[seen.point],
        exterior_free=sensors.exterior_free,
        interior_free=np.ones(sensors.interior.shape, bool),
        point_free=np.concatenate([s.point_free[points], s.exterior_free[images, :3]]),
        check_point=stand.point[s.check_point][check],
        datum=Datum("control", carriers=s.datum.carriers) if s.datum.kind in ("control", "fixed") else Datum("open"),
        rotation_system=s.rotation_system,
        object_unit=s.object_unit,
        angle_unit=s.angle_unit,
        parameters=s.parameters,
        source=s.source,
    )
    places = np.concatenate(
        [np.asarray(block.object_points)[points], np.asarray(block.exterior.projection_centre)[images]]
    )
    new = Block(
        structure,
        ExteriorOrientation(on_device(sensors.centres), on_device(sensors.angles)),
        InteriorOrientation(on_device(sensors.interior)),
        on_device(places),
        Rays(on_device(numbers), on_device(np.ones((len(seen.sensor), 3)))),
        (*groups, *more),
        CheckPoints(block.check_points.coordinates[check], block.check_points.sigmas[check]),
        block.parameters,
    )
    return SensorBlock(new, sensors, points, images, told)


def _centre_names(block: Block, images: Int[np.ndarray, " centre"]) -> list[str]:
    """Unique names of the projection centres as points."""
    s = block.structure
    taken, names = set(s.point_names), []
    for i in images:
        name = CENTRE + s.image_names[i]
        while name in taken:
            name += "'"
        names.append(name)
    return names
