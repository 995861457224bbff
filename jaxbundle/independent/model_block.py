"""Converting a block of photographs to a block of independent models, which the engine of the bundle adjusts."""

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import ObservationGroup, interior_priors, observation_group
from jaxbundle.independent.formation import Models
from jaxbundle.independent.sensor_block import Seen, SensorBlock, Sensors, sensor_block
from jaxbundle.independent.sensors import MODEL, MODEL_WITH_ERRORS, SHARED, factor_numbers

SMALL = 1e-2  # ratio of the standard deviations of a centre without errors and of the model's points


def seen_points(block: Block, models: Models, whole: bool) -> Seen:
    """Points of all models. `whole`: whether covariances of the points include the shared errors.

    Then they refer to all points of the model: similarity transformations, which the seven unknowns of a model absorb,
    are removed from the errors (inner constraints, S-transformation of Baarda 1973).
    """
    count, parts = len(block.structure.point_names), []
    for m in range(len(models)):
        used = np.flatnonzero(models.used[m])
        own = models.own[m, used]
        x = np.concatenate([models.coordinates[m, used], np.zeros((1, 3)), models.base[m][None]])
        shared = np.concatenate([models.shared[m, used], np.zeros((1, 3, 5)), models.shared_base[m][None]])
        noise = np.concatenate([own @ own.transpose(0, 2, 1), np.zeros((2, 3, 3))])
        if whole:
            noise = _inner(x, noise, shared)
        else:
            noise[-2:] = SMALL**2 * np.median(np.trace(noise[:-2], axis1=1, axis2=2)) / 3 * np.eye(3)
        point = np.concatenate([models.point[m, used], count + models.pair[m]])
        parts.append(Seen(np.full(len(x), m), point, x, noise, shared))
    return Seen(*map(np.concatenate, zip(*parts, strict=True)))


def _inner(
    x: Float[np.ndarray, "ray 3"], noise: Float[np.ndarray, "ray 3 3"], shared: Float[np.ndarray, "ray 3 5"]
) -> Float[np.ndarray, "ray 3 3"]:
    """Covariances of the points after the S-transformation: diagonal blocks of S (D + C C^T) S^T, S = I - G H."""
    centred = x - x.mean(0)
    size = np.sqrt(np.mean(centred**2))
    g = np.zeros((len(x), 3, 7))
    g[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        g[:, :, 3 + k] = np.cross(axis, centred / size)
    g[:, :, 6] = centred / size
    h = np.linalg.solve(np.einsum("pik,pil->kl", g, g), g.reshape(-1, 7).T).reshape(7, -1, 3)
    hd = np.einsum("kpi,pij->pkj", h, noise)
    gh = g @ hd
    whole = np.einsum("pkj,lpj->kl", hd, h)
    transformed = shared - g @ np.einsum("kpi,pie->ke", h, shared)
    return (
        noise
        - gh
        - gh.transpose(0, 2, 1)
        + g @ whole @ g.transpose(0, 2, 1)
        + transformed @ transformed.transpose(0, 2, 1)
    )


def model_block(block: Block, models: Models, estimate_shared: bool) -> SensorBlock:
    """The block of these models, with approximate values from the photographs.

    `estimate_shared`: whether the common errors of all points of a model are unknowns; otherwise they are in the
    covariances of the single points.
    """
    s, seen = block.structure, seen_points(block, models, not estimate_shared)
    names = tuple(f"{s.image_names[i]}-{s.image_names[j]}" for i, j in models.pair)
    numbers = [seen.coordinates, factor_numbers(seen.covariances)]
    if estimate_shared:
        numbers.append(seen.shared.reshape(-1, 15))
    first = models.pair[:, 0]
    sensor, within = np.full(len(s.image_names), -1, np.int32), np.tile(np.eye(3), (len(s.image_names), 1, 1))
    order = np.arange(len(models))
    sensor[models.pair[:, 1]], within[models.pair[:, 1]] = order, models.rotation
    sensor[first], within[first] = order, np.eye(3)
    free = np.ones((len(models), 6), bool)
    free[:, 3:] = s.exterior_free[first, 3:]  # fixed angles of a first image are those of the model
    model = MODEL_WITH_ERRORS if estimate_shared else MODEL
    interior = np.zeros((len(models), len(model.elements)))
    interior[:, 0] = 1.0
    centres, angles = np.asarray(block.exterior.projection_centre)[first], np.asarray(block.exterior.angles)[first]
    return sensor_block(
        block,
        seen,
        np.concatenate(numbers, 1),
        Sensors(names, model, centres, angles, free, interior, sensor, within),
        (_no_errors(len(models)),) if estimate_shared else (),
    )


def _no_errors(models: int) -> ObservationGroup:
    """The shared errors observed as 0 with the standard deviation 1."""
    nothing, one = np.zeros((models, 1 + len(SHARED))), np.ones((models, 1 + len(SHARED)))
    nothing[:, 0] = np.nan
    return observation_group(interior_priors(MODEL_WITH_ERRORS.elements), np.arange(models)[:, None], nothing, one)
