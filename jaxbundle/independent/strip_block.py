"""Strips as sensors: seven parameters each for their first orientation, then the coefficients of polynomials."""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import ObservationGroup, interior_priors, observation_group
from jaxbundle.independent.formation import Models
from jaxbundle.independent.joined import Strip
from jaxbundle.independent.polynomials import Form, curbed, strip_sensor
from jaxbundle.independent.sensor_block import Seen, SensorBlock, Sensors, sensor_block
from jaxbundle.independent.sensors import MODEL, factor_numbers
from jaxbundle.solve.adjustment import Adjustment

PARALLAX = 2.0  # standard deviations of a y-coordinate, the mean of two rays, in that of a parallax, their difference
END = {
    "X": 1.1,
    "Y": 0.57,
    "Z": 0.93,
}  # constants of the errors at the end of a strip of n models, relative to m m_q n^1.5 (Z: times f / b)
NARROW = 1e-3  # share of the length: minimum half of the width


class Frame(NamedTuple):
    """The system of a strip: x along the strip, z up, the origin in its middle."""

    origin: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]
    """Matrix object_from_strip."""
    half_length: float
    half_width: float
    turned: Float[np.ndarray, "3 3"]
    """Matrix that converts small vectors of the joined strip to this system: rotation divided by scale."""
    coordinates: Float[np.ndarray, "point 3"]
    """Coordinates of points and projection centres, pre-oriented."""
    rotation: Float[np.ndarray, "image 3 3"]
    """The rotation matrices strip_from_image."""


def seen_by_strips(block: Block, strips: tuple[Strip, ...]) -> Seen:
    """Points and projection centres of the strips in their own systems."""
    count = len(block.structure.point_names)
    point = np.concatenate([np.concatenate([s.points, count + s.images]) for s in strips])
    sizes = [len(s.points) + len(s.images) for s in strips]
    return Seen(
        np.repeat(np.arange(len(strips)), sizes),
        point,
        np.concatenate([np.concatenate([s.coordinates, s.centres]) for s in strips]),
        np.concatenate([np.concatenate([s.covariances, s.centre_covariances]) for s in strips]),
        np.zeros((len(point), 3, 5)),
    )


def _of_image(block: Block, strips: tuple[Strip, ...]) -> Int[np.ndarray, " image"]:
    found = np.full(len(block.structure.image_names), -1, np.int32)
    for k, strip in enumerate(strips):
        found[strip.images] = k
    return found


def rigid_block(block: Block, strips: tuple[Strip, ...], names: tuple[str, ...]) -> SensorBlock:
    """The strips with seven parameters each."""
    seen = seen_by_strips(block, strips)
    first = np.array([strip.images[0] for strip in strips])
    rotation = np.tile(np.eye(3), (len(block.structure.image_names), 1, 1))
    for strip in strips:
        rotation[strip.images] = strip.rotation
    centres, angles = np.asarray(block.exterior.projection_centre)[first], np.asarray(block.exterior.angles)[first]
    free = np.ones((len(strips), 6), bool)
    interior = np.ones((len(strips), 1))
    sensors = Sensors(names, MODEL, centres, angles, free, interior, _of_image(block, strips), rotation)
    numbers = np.concatenate([seen.coordinates, factor_numbers(seen.covariances)], 1)
    return sensor_block(block, seen, numbers, sensors, ())


def frames(rigid: Adjustment, strips: tuple[Strip, ...]) -> tuple[Frame, ...]:
    """The systems of the strips after their first orientation."""
    system = rigid.block.structure.rotation_system
    angles = np.asarray(rigid.block.exterior.angles)
    centres, scales = (
        np.asarray(rigid.block.exterior.projection_centre),
        np.asarray(rigid.block.interior.elements)[:, 0],
    )
    found = []
    for k, strip in enumerate(strips):
        matrix = np.array([float(x) for x in system.rotation_from_angles(*angles[k])]).reshape(3, 3)
        local = np.concatenate([strip.coordinates, strip.centres])
        there = centres[k] + local @ matrix.T / scales[k]
        along = there[-1] - there[len(strip.points)]
        up = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 * np.linalg.norm(along) else np.array([0.0, 1.0, 0.0])
        x = along - (along @ up) * up
        x /= np.linalg.norm(x)
        axes = np.stack([x, np.cross(up, x), up], 1)
        inside = (there - there[0]) @ axes
        ground = inside[: len(strip.points)]
        middle = (ground.min(0) + ground.max(0)) / 2
        middle[2] = ground[:, 2].mean()
        coordinates = inside - middle
        half_length = float(np.abs(coordinates[:, 0]).max())
        half_width = max(float(np.abs(coordinates[: len(strip.points), 1]).max()), NARROW * half_length)
        turned = axes.T @ matrix
        found.append(
            Frame(
                there[0] + axes @ middle,
                axes,
                half_length,
                half_width,
                turned / scales[k],
                coordinates,
                turned @ strip.rotation,
            )
        )
    return tuple(found)


def normalised(frame: Frame, coordinates: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 4"]:
    """Input of the polynomials: x, y, z relative to half of the length, y relative to half of the width."""
    return np.column_stack([coordinates / frame.half_length, coordinates[:, 1] / frame.half_width])


def polynomial_block(
    block: Block, strips: tuple[Strip, ...], in_frames: tuple[Frame, ...], sensors: Sensors, curbs: ObservationGroup
) -> SensorBlock:
    """The strips with the coefficients of polynomials."""
    seen = seen_by_strips(block, strips)
    coordinates = np.concatenate([frame.coordinates for frame in in_frames])
    turned = np.stack([frame.turned for frame in in_frames])[seen.sensor]
    covariances = turned @ seen.covariances @ turned.transpose(0, 2, 1)
    places = np.concatenate([normalised(frame, frame.coordinates) for frame in in_frames])
    numbers = np.concatenate([coordinates, factor_numbers(covariances), places], 1)
    return sensor_block(block, seen._replace(coordinates=coordinates), numbers, sensors, (curbs,))


def polynomial_sensors(
    block: Block, strips: tuple[Strip, ...], in_frames: tuple[Frame, ...], names: tuple[str, ...], how: tuple[Form, int]
) -> Sensors:
    """Strips in fixed systems of their own; all coefficients are 0 at the start."""
    system, model = block.structure.rotation_system, strip_sensor(*how)
    angles = np.array([[float(a) for a in system.angles_from_rotation(tuple(f.axes.ravel()))] for f in in_frames])
    rotation = np.tile(np.eye(3), (len(block.structure.image_names), 1, 1))
    for strip, frame in zip(strips, in_frames, strict=True):
        rotation[strip.images] = frame.rotation
    return Sensors(
        names,
        model,
        np.stack([frame.origin for frame in in_frames]),
        angles,
        np.zeros((len(strips), 6), bool),
        np.zeros((len(strips), len(model.elements))),
        _of_image(block, strips),
        rotation,
    )


def end_errors(models: Models, strip: Strip) -> dict[str, float]:
    """Expected errors at the free end of a strip for each coordinate, object unit (law of accumulation in strips)."""
    n, parallax, ratio = len(strip.models), [], []
    for m in strip.models:
        used = models.used[m]
        noise = models.own[m, used] @ models.own[m, used].transpose(0, 2, 1)
        parallax.append(PARALLAX * np.sqrt(np.median(np.linalg.eigvalsh(noise)[:, 0])))
        ratio.append(np.linalg.norm(models.coordinates[m, used], axis=1).mean() / np.linalg.norm(models.base[m]))
    size = float(np.mean(parallax)) * n**1.5
    return {c: END[c] * size * (float(np.mean(ratio)) if c == "Z" else 1.0) for c in "XYZ"}


def curb_group(ends: list[dict[str, float]], how: tuple[Form, int]) -> ObservationGroup:
    """The curved coefficients of all strips, observed as 0 with their expected size; of degree 3 half of it."""
    names = strip_sensor(*how).elements
    values, sigmas = np.full((len(ends), len(names)), np.nan), np.ones((len(ends), len(names)))
    for name, (coordinate, degree) in curbed(*how).items():
        column = names.index(name)
        values[:, column] = 0.0
        sigmas[:, column] = [end[coordinate] / (2 if degree == 3 else 1) for end in ends]
    return observation_group(interior_priors(names), np.arange(len(ends))[:, None], values, sigmas)


def strip_errors(strips: tuple[Strip, ...], in_frames: tuple[Frame, ...]) -> sp.csr_matrix:
    """Errors of all points of the strips, in their systems, with respect to errors of the image coordinates."""
    parts = []
    for strip, frame in zip(strips, in_frames, strict=True):
        count = len(strip.points) + len(strip.images)
        parts.append(sp.kron(sp.identity(count), sp.csr_matrix(frame.turned)) @ strip.errors)
    return sp.csr_matrix(sp.vstack(parts))
