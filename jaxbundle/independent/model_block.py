"""A block of photographs as a block of independent models, which the engine of the bundle adjusts."""

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
from jaxbundle.block.observations import interior_priors, observation_group
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.independent.formation import Models
from jaxbundle.independent.sensors import MODEL, MODEL_WITH_ERRORS, SHARED, factor_numbers
from jaxbundle.independent.translated import Stand, translated
from jaxbundle.numerics.host import on_device

CENTRE = "centre of "  # before the name of an image: the object point that is its projection centre
SMALL = 1e-2  # standard deviation of a centre that has no errors of its own, over that of the model's points


class ModelBlock(NamedTuple):
    """The block of models, and how it belongs to that of the photographs."""

    block: Block
    stand: Stand
    points: Int[np.ndarray, " new"]
    """Of the photographs; the projection centres follow."""
    images: Int[np.ndarray, " centre"]
    """Images whose projection centres follow, in this order."""
    findings: tuple[Finding, ...]


class Seen(NamedTuple):
    """Points that sensors see: model points, then projection centres."""

    sensor: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    """Of the photographs, or number of points + image for a projection centre."""
    coordinates: Float[np.ndarray, "ray 3"]
    covariances: Float[np.ndarray, "ray 3 3"]
    """Of single points."""
    shared: Float[np.ndarray, "ray 3 5"]


def seen_points(block: Block, models: Models, whole: bool) -> Seen:
    """What every model sees. `whole`: covariances of the points have the shared errors in them.

    Then they are those of the model with respect to all of its points: every similarity transformation, as the seven
    unknowns of a model are one, is taken out of the errors (inner constraints, S-transformation of Baarda 1973).
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
    return noise - gh - gh.transpose(0, 2, 1) + g @ whole @ g.transpose(0, 2, 1) + transformed @ transformed.transpose(
        0, 2, 1
    )


def model_block(block: Block, models: Models, estimate_shared: bool) -> ModelBlock:
    """The block of these models; every value of the photographs is its start.

    `estimate_shared`: the errors that all points of a model share are unknowns; else they are in the covariances of the
    points one by one.
    """
    s, seen = block.structure, seen_points(block, models, not estimate_shared)
    count = len(s.point_names)
    taking_part = np.unique(seen.point)
    number = np.full(count + len(s.image_names), -1, np.int32)
    number[taking_part] = np.arange(len(taking_part))
    points, images = taking_part[taking_part < count], taking_part[taking_part >= count] - count
    stand = _stand(models, number[:count], number[count:])
    matrices = np.asarray(unknowns_of(block).rotation).T.reshape(-1, 3, 3)
    groups, told = translated(block.groups, {"point": s.point_names, "image": s.image_names}, stand)
    sensor = MODEL_WITH_ERRORS if estimate_shared else MODEL
    if estimate_shared:
        groups = (*groups, _no_errors(len(models)))
    numbers = [seen.coordinates, factor_numbers(seen.covariances)]
    numbers += [seen.shared.reshape(-1, 15)] if estimate_shared else []
    names = tuple(f"{s.image_names[i]}-{s.image_names[j]}" for i, j in models.pair)
    check = stand.point[s.check_point] >= 0
    first = models.pair[:, 0]
    structure = Structure(
        name=s.name,
        cameras=tuple(Camera(name, sensor, "mm") for name in names),
        image_names=names,
        point_names=tuple([s.point_names[p] for p in points] + _centre_names(s, images)),
        image_camera=np.arange(len(models), dtype=np.int32),
        ray_image=seen.sensor.astype(np.int32),
        ray_point=number[seen.point],
        exterior_free=_exterior_free(block, first),
        interior_free=np.ones((len(models), len(sensor.elements)), bool),
        point_free=np.concatenate([s.point_free[points], s.exterior_free[images, :3]]),
        check_point=stand.point[s.check_point][check],
        datum=Datum("control", carriers=s.datum.carriers) if s.datum.kind in ("control", "fixed") else Datum("open"),
        rotation_system=s.rotation_system,
        object_unit=s.object_unit,
        angle_unit=s.angle_unit,
        parameters=s.parameters,
        source=s.source,
    )
    interior = np.zeros((len(models), len(sensor.elements)))
    interior[:, 0] = 1.0
    exterior = ExteriorOrientation(block.exterior.projection_centre[first], block.exterior.angles[first])
    places = np.concatenate([_points(block, models)[points], np.asarray(block.exterior.projection_centre)[images]])
    return ModelBlock(
        Block(
            structure,
            exterior,
            InteriorOrientation(on_device(interior)),
            on_device(places),
            Rays(on_device(np.concatenate(numbers, 1)), on_device(np.ones((len(seen.sensor), 3)))),
            groups,
            CheckPoints(block.check_points.coordinates[check], block.check_points.sigmas[check]),
            block.parameters,
        ),
        stand,
        points,
        images,
        told,
    )


def _stand(models: Models, point: Int[np.ndarray, " point"], centre: Int[np.ndarray, " image"]) -> Stand:
    """The images by the model they are the first image of, else by one they are the second image of."""
    sensor, within = np.full(len(centre), -1, np.int32), np.tile(np.eye(3), (len(centre), 1, 1))
    order = np.arange(len(models))
    sensor[models.pair[:, 1]], within[models.pair[:, 1]] = order, models.rotation
    sensor[models.pair[:, 0]], within[models.pair[:, 0]] = order, np.eye(3)
    return Stand(point, centre, sensor, within)


def _exterior_free(block: Block, first: Int[np.ndarray, " model"]) -> Bool[np.ndarray, "model 6"]:
    """Angles that are held of a first image are those of the model; its projection centre is held as a point."""
    free = np.ones((len(first), 6), bool)
    free[:, 3:] = block.structure.exterior_free[first, 3:]
    return free


def _centre_names(s: Structure, images: Int[np.ndarray, " centre"]) -> list[str]:
    """Names of the projection centres as points, which no other point has."""
    taken = set(s.point_names)
    names = []
    for i in images:
        name = CENTRE + s.image_names[i]
        while name in taken:
            name += "'"
        names.append(name)
    return names


def _no_errors(models: int) -> object:
    """The shared errors observed as 0 with the standard deviation 1."""
    nothing, one = np.zeros((models, 1 + len(SHARED))), np.ones((models, 1 + len(SHARED)))
    nothing[:, 0] = np.nan
    return observation_group(interior_priors(MODEL_WITH_ERRORS.elements), np.arange(models)[:, None], nothing, one)


def _points(block: Block, models: Models) -> Float[np.ndarray, "point 3"]:
    """Approximate object points; those without coordinates from a model."""
    points = np.array(block.object_points)
    matrices = np.asarray(unknowns_of(block).rotation).T.reshape(-1, 3, 3)
    centres = np.asarray(block.exterior.projection_centre)
    for m, (i, _) in enumerate(models.pair):
        used = models.used[m]
        there, at = models.coordinates[m, used] @ matrices[i].T + centres[i], models.point[m, used]
        points[at] = np.where(np.isnan(points[at]), there, points[at])
    return points
