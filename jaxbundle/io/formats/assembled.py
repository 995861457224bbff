"""Making a block from a foreign block, once for all formats."""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import (
    Block,
    Camera,
    CheckPoints,
    Datum,
    ExteriorOrientation,
    InteriorOrientation,
    Parameter,
    Rays,
    Structure,
)
from jaxbundle.block.findings import Finding, Kind, in_order
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.block.navigation import ATTITUDES
from jaxbundle.block.observation_kinds import CONTROL, STATIONS, ObservationGroup, observation_group
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.control_system import at_control, in_control_system
from jaxbundle.io.formats.decided import decided
from jaxbundle.io.formats.foreign_block import ForeignBlock, ForeignCamera, Known, element
from jaxbundle.io.formats.usable_part import usable
from jaxbundle.io.noted import measured_again
from jaxbundle.io.ranges import MAX_LENGTH, MAX_SIGMA, PRINCIPAL_DISTANCES, SMALLEST_SIGMA
from jaxbundle.numerics.host import on_device, on_host

SYSTEMATIC = 9  # parameters of an observed attitude, all fixed at 0


def assembled(foreign: ForeignBlock) -> Block:
    """Makes the block: with the interpretation that fits, usable images and points, in the system of the control.

    Assumptions and problems are in the findings.

    Raises: BlockError where no interpretation fits, or no usable observations remain.
    """
    foreign = usable(decided(_named_once(foreign)))
    _require_numbers(foreign)
    block = _block(foreign)
    block = at_control(in_control_system(block, foreign), foreign)
    missing = np.isnan(on_host(block.object_points)).any(1)
    if missing.any():
        names = [foreign.points.names[k] for k in np.flatnonzero(missing)]
        what = f"{len(names)} points have no coordinates and their rays do not intersect, such as {names[0]}"
        raise BlockError([Problem(what, "leave them out of the file", "points")])
    return block


def _named_once(foreign: ForeignBlock) -> ForeignBlock:
    """Makes the block. Raises: BlockError where two images, points or cameras have the same name."""
    problems = []
    named = {
        "images": foreign.images.names,
        "points": foreign.points.names,
        "cameras": tuple(camera.name for camera in foreign.cameras),
    }
    for what, names in named.items():
        if len(set(names)) < len(names):
            seen: set[str] = set()
            again = [name for name in names if name in seen or seen.add(name)]
            problems.append(
                Problem(f"{len(again)} names of {what} occur twice, such as '{again[0]}'", "rename them", what)
            )
        if "" in names:
            problems.append(Problem(f"one of the {what} has no name", "add the name", what))
    if problems:
        raise BlockError(problems)
    return foreign


def _require_numbers(foreign: ForeignBlock) -> None:
    """Raises BlockError for a block without rays and for numbers outside the range of a block."""
    problems = []
    if not len(foreign.rays.image):
        what = f"{foreign.format} {foreign.name} has no point measured on two oriented images"
        cure = "export it with image measurements and tie points"
        raise BlockError([Problem(what, cure)])
    for camera in foreign.cameras:
        values = [element(camera, name) for name in camera.model.elements]
        c = element(camera, "principal_distance")
        if not np.isfinite(values).all() or not PRINCIPAL_DISTANCES[0] <= c <= PRINCIPAL_DISTANCES[1]:
            what = f"camera {camera.name} has implausible elements (principal distance {c:g})"
            problems.append(Problem(what, "correct the interior orientation", "cameras"))
    tables = (
        ("images", foreign.images.centre, MAX_LENGTH),
        ("points", foreign.points.coordinates, MAX_LENGTH),
        ("rays", foreign.rays.xy, MAX_LENGTH),
        ("control", np.array([row.coordinates for row in foreign.control]), MAX_LENGTH),
        ("stations", np.array([row.coordinates for row in foreign.stations]), MAX_LENGTH),
    )
    for what, values, limit in tables:
        if values.size and not (np.abs(np.nan_to_num(values, nan=0.0)) <= limit).all():
            problems.append(Problem(f"{what} have numbers larger than {limit:g}", "correct them", what))
    sigma = foreign.rays.sigma
    if sigma is not None and not ((sigma >= SMALLEST_SIGMA) & (sigma <= MAX_SIGMA)).all():
        problems.append(Problem("a standard deviation of image coordinates is not positive", "correct it", "rays"))
    if problems:
        raise BlockError(problems)


def _block(foreign: ForeignBlock) -> Block:
    images, points, rays = foreign.images, foreign.points, foreign.rays
    elements, free = _interior(foreign.cameras)
    angles = rotations.to_angles(images.rotation)
    coordinates, held = _with_control(foreign)
    check, check_points = _check_points(foreign)
    groups, parameters = _groups(foreign)
    sigma = np.full(len(rays.image), foreign.sigma) if rays.sigma is None else rays.sigma
    source = f"{foreign.format} {foreign.name}"
    structure = Structure(
        name=foreign.name,
        cameras=tuple(Camera(c.name, c.model, c.image_unit, c.width, c.height, _is_metric(c)) for c in foreign.cameras),
        image_names=images.names,
        point_names=points.names,
        image_camera=images.camera.astype(np.int32),
        ray_image=rays.image.astype(np.int32),
        ray_point=rays.point.astype(np.int32),
        exterior_free=np.ones((len(images.names), 6), bool),
        interior_free=free,
        point_free=~held,
        check_point=check,
        datum=Datum("open"),
        rotation_system=OMEGA_PHI_KAPPA,
        parameters=parameters,
        source=f"{source}; coordinate system: {foreign.coordinate_system}" if foreign.coordinate_system else source,
        findings=in_order([*foreign.findings, *_assumed(foreign), *_again(foreign)]),
    )
    return Block(
        structure,
        ExteriorOrientation(on_device(images.centre), on_device(angles)),
        InteriorOrientation(on_device(elements)),
        on_device(coordinates),
        Rays(on_device(rays.xy), on_device(np.stack([sigma, sigma], -1))),
        groups,
        check_points,
        on_device(np.zeros(len(parameters))),
    )


def _is_metric(camera: ForeignCamera) -> bool:
    return camera.image_unit == "px" and "pixel_size" in camera.model.elements and element(camera, "pixel_size") != 1.0


def _assumed(foreign: ForeignBlock) -> list[Finding]:
    return [Finding(Kind.INFORMATION, f"{foreign.format}: assumed that {words}") for words in foreign.assumptions]


def _again(foreign: ForeignBlock) -> list[Finding]:
    """Rays that repeat the point of an earlier ray on the same image."""
    rays = foreign.rays
    pair = rays.point * np.int64(len(foreign.images.names)) + rays.image
    _, first = np.unique(pair, return_index=True)
    if len(first) == len(pair):
        return []
    again = np.setdiff1d(np.arange(len(pair)), first)
    names = [(foreign.images.names[rays.image[k]], foreign.points.names[rays.point[k]]) for k in again]
    return [measured_again(names)]


def _interior(
    cameras: tuple[ForeignCamera, ...],
) -> tuple[Float[np.ndarray, "camera element"], Bool[np.ndarray, "camera element"]]:
    length = max(len(camera.model.elements) for camera in cameras)
    elements, free = np.ones((len(cameras), length)), np.zeros((len(cameras), length), bool)
    for row, camera in enumerate(cameras):
        for k, name in enumerate(camera.model.elements):
            elements[row, k] = element(camera, name)
            free[row, k] = name in camera.estimate
    return elements, free


def _with_control(foreign: ForeignBlock) -> tuple[Float[np.ndarray, "point 3"], Bool[np.ndarray, "point 3"]]:
    """Coordinates of the points, and a mask of the coordinates that control fixes.

    Points that cannot be intersected have the coordinates of the control.
    """
    coordinates, held = foreign.points.coordinates.copy(), np.zeros((len(foreign.points.names), 3), bool)
    position = {name: k for k, name in enumerate(foreign.points.names)}
    for row in foreign.control:
        k, known = position[row.name], np.array(row.coordinates)
        if np.isnan(coordinates[k]).any():
            coordinates[k] = np.where(np.isfinite(known), known, coordinates[k])
        held[k] = np.isfinite(known) & (np.array(row.sigmas) == 0) & (not row.check)
    return coordinates, held


def _check_points(foreign: ForeignBlock) -> tuple[Int[np.ndarray, " check"], CheckPoints]:
    position = {name: k for k, name in enumerate(foreign.points.names)}
    rows = [row for row in foreign.control if row.check]
    index = np.array([position[row.name] for row in rows], np.int32)
    values = np.array([row.coordinates for row in rows]).reshape(-1, 3)
    sigmas = np.array([row.sigmas for row in rows]).reshape(-1, 3)
    return index, CheckPoints(on_device(values), on_device(sigmas))


def _rows(known: list[Known], position: dict[str, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices, values and sigmas; coordinates with sigma 0 or without sigma are not observed here."""
    index = np.array([position[row.name] for row in known], np.int64)
    values = np.array([row.coordinates for row in known], float).reshape(-1, 3)
    sigmas = np.array([row.sigmas for row in known], float).reshape(-1, 3)
    return index, values, np.where((sigmas > 0) & np.isfinite(sigmas), sigmas, np.nan)


def _groups(foreign: ForeignBlock) -> tuple[tuple[ObservationGroup, ...], tuple[Parameter, ...]]:
    """Groups of control, stations, attitudes and distances, and the fixed parameters of attitudes."""
    points = {name: k for k, name in enumerate(foreign.points.names)}
    images = {name: k for k, name in enumerate(foreign.images.names)}
    groups, parameters = [], ()
    for kind, rows, position in (
        (CONTROL, [row for row in foreign.control if not row.check], points),
        (STATIONS, list(foreign.stations), images),
    ):
        index, values, sigmas = _rows(rows, position)
        used = np.isfinite(values * sigmas).any(1)
        if used.any():
            groups.append(observation_group(kind, index[used][:, None], values[used], sigmas[used]))
    index, values, sigmas = _rows(list(foreign.attitudes), images)
    if len(index):
        parameters = tuple(
            Parameter(f"{what}{k}", unit, False, unit == "deg")
            for what, unit in (("boresight ", "deg"), ("attitude shift ", "deg"), ("attitude drift ", "deg"))
            for k in (1, 2, 3)
        )
        touched = np.column_stack([index, *(np.full(len(index), k) for k in range(SYSTEMATIC))])
        kind = ATTITUDES[OMEGA_PHI_KAPPA.name]
        groups.append(observation_group(kind, touched, values, sigmas, np.zeros((len(index), 1))))
    if foreign.distances:
        ends = np.array([[points[row.start], points[row.end]] for row in foreign.distances])
        lengths = np.array([[row.distance] for row in foreign.distances])
        groups.append(observation_group(DISTANCES, ends, lengths, np.array([[row.sigma] for row in foreign.distances])))
    return tuple(groups), parameters
