"""Simulated blocks with one mistake each, its size in multiples of the smallest that the test finds with its power."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from cases.all_observations import observed

from jaxbundle.block.block import (
    Block,
    Camera,
    CheckPoints,
    Datum,
    ExteriorOrientation,
    InteriorOrientation,
    Rays,
    Structure as BlockStructure,
)
from jaxbundle.block.findings import Subject
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.camera.brown import DISTORTION_FREE
from jaxbundle.diagnosis.after_failure import causes
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA
from jaxbundle.numerics.host import on_device
from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.simulation import exact_coordinates, simulate
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.verdict import BEYOND_USE
from jaxbundle.statistics.error_columns import FIXED, ErrorColumn, error_tests
from jaxbundle.statistics.possible_errors import computed_values, possible_errors
from jaxbundle.statistics.reliability_tables import POWER, level_of_one, non_centrality, reliability
from jaxbundle.statistics.suspects import find_suspects, with_errors_removed

PIXELS = AerialCamera(120.0, 104.0, 68.0, pixel_size=0.012)
SELF_CALIBRATED = AerialCamera(
    100.0, 104.0, 68.0, 0.012, (0.05, -0.03), {"K1": -2e-6}, ("principal_distance", "x0", "y0", "K1")
)
ROUGH = 0.01  # of the distance to the points, and in radians: errors of the values at which an adjustment begins
ITERATIONS = 60  # of one adjustment


def strip() -> Block:
    """A strip over control points that are fixed."""
    return simulate(1, 5, camera=PIXELS, points_per_image=25, control_rows=4, forward_overlap=0.7, seed=1).truth


def weighted() -> Block:
    """Two strips over control points with sigmas."""
    options = {"forward_overlap": 0.7, "side_overlap": 0.4, "points_per_image": 20, "control_rows": 3}
    return simulate(2, 3, camera=PIXELS, control_sigma=0.05, seed=2, **options).truth


def stations() -> Block:
    """Two strips with observed stations and few control points."""
    options = {"forward_overlap": 0.7, "side_overlap": 0.4, "points_per_image": 20, "control_rows": 2}
    return simulate(2, 4, camera=PIXELS, control_sigma=0.05, station_sigma=0.1, seed=3, **options).truth


def self_calibrating() -> Block:
    """Two strips with control points and stations, whose camera is calibrated too."""
    options = {"forward_overlap": 0.7, "side_overlap": 0.4, "points_per_image": 25, "control_rows": 3}
    return simulate(2, 4, camera=SELF_CALIBRATED, control_sigma=0.05, station_sigma=0.1, seed=4, **options).truth


def close_range() -> Block:
    """Eight convergent, turned images around an object of 2 m, and distances between its points; a free network."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (30, 3))
    around = np.arange(8) * np.pi / 4
    centres = np.stack([5 * np.cos(around), 5 * np.sin(around), 2 + (-1.0) ** np.arange(8)], 1)
    backward = centres / np.linalg.norm(centres, axis=1)[:, None]  # z of the photograph points away from the object
    sideways = np.cross([0.0, 0.0, 1.0], backward)
    sideways /= np.linalg.norm(sideways, axis=1)[:, None]
    upward = np.cross(backward, sideways)
    turn = (around * 2)[:, None]
    first, second = (
        np.cos(turn) * sideways + np.sin(turn) * upward,
        np.cos(turn) * upward - np.sin(turn) * sideways,
    )
    matrix = np.stack([first, second, backward], 2).reshape(8, 9).T
    angles = np.stack([np.asarray(a) for a in OMEGA_PHI_KAPPA.angles_from_rotation(tuple(jnp.asarray(matrix)))], 1)
    image, point = (x.ravel() for x in np.meshgrid(np.arange(8), np.arange(30), indexing="ij"))
    structure = BlockStructure(
        name="close range",
        cameras=(Camera("camera", DISTORTION_FREE, "px", 6000, 4000),),
        image_names=tuple(f"p{k}" for k in range(8)),
        point_names=tuple(str(k) for k in range(30)),
        image_camera=np.zeros(8, np.int32),
        ray_image=image.astype(np.int32),
        ray_point=point.astype(np.int32),
        exterior_free=np.ones((8, 6), bool),
        interior_free=np.zeros((1, len(DISTORTION_FREE.elements)), bool),
        point_free=np.ones((30, 3), bool),
        check_point=np.zeros(0, int),
        datum=Datum("inner"),
    )
    empty = on_device(np.zeros((0, 3)))
    elements = dict(zip(DISTORTION_FREE.elements, np.zeros(9), strict=False))
    elements |= {"principal_distance": 6000.0, "x0": 3000.0, "y0": 2000.0, "pixel_size": 1.0, "y_axis": -1.0}
    block = Block(
        structure,
        ExteriorOrientation(on_device(centres), on_device(angles)),
        InteriorOrientation(on_device(np.array([[elements[e] for e in DISTORTION_FREE.elements]]))),
        on_device(points),
        Rays(on_device(np.zeros((240, 2))), on_device(np.full((240, 2), 0.3))),
        (),
        CheckPoints(empty, empty),
    )
    block = eqx.tree_at(lambda b: b.rays.coordinates, block, on_device(exact_coordinates(block)[0]))
    far = [[a, b] for a, b in np.random.default_rng(6).permutation(30)[:8].reshape(4, 2)]
    return observed(block, DISTANCES, far, 2e-4)


BLOCKS = {f.__name__: f for f in (strip, weighted, stations, self_calibrating, close_range)}


@dataclass(frozen=True)
class Mistake:
    """One mistake: the subjects that are wrong, and the elementary errors of a unit size; `fixed`: its size is 1, which
    is no matter of choice."""

    subjects: tuple[Subject, ...]
    errors: tuple[tuple[ErrorColumn, float], ...]
    detectable: float  # size that is found with the power of the test
    fixed: bool = False


class Outcome(NamedTuple):
    """`first`: the culprit is named first; `found`: somewhere; `wrongly`: others that are named."""

    first: bool
    found: bool
    wrongly: int


class Simulated:
    """A block at its truth, and the mistakes that can be made with it."""

    def __init__(self, name: str):
        self.name, self.truth = name, BLOCKS[name]()
        self.start = adjust(drawn(self.truth, np.random.default_rng(0)))
        w = [np.asarray(v) for v in reliability(self.start).w]
        residuals = [np.asarray(v) for v in self.start.weighted_residuals]
        tests = possible_errors(self.start.block, w, computed_values(self.start.block, residuals)).tests
        self.root = non_centrality(level_of_one(0.05, tests), POWER)

    def adjusted(self, rng: np.random.Generator, mistake: Mistake | None, size: float) -> Adjustment:
        """An adjustment of the block with other normal errors and a mistake."""
        return adjust(self.given(rng, mistake, size), max_iterations=ITERATIONS)

    def given(self, rng: np.random.Generator, mistake: Mistake | None, size: float) -> Block:
        """The block with other normal errors and a mistake, at rough values of its unknowns."""
        block = drawn(self.truth, rng)
        if mistake is not None:
            block = with_errors_removed(block, [(column, -size * s) for column, s in mistake.errors])
        now = self.start.block
        free, points = now.structure.point_free, np.asarray(now.object_points)
        centres, angles = np.asarray(now.exterior.projection_centre), np.asarray(now.exterior.angles)
        rough = ROUGH * float(np.linalg.norm(centres[:, None] - points, axis=2).min())
        points = np.where(free, points + rough * rng.standard_normal(points.shape), np.asarray(block.object_points))
        exterior = ExteriorOrientation(
            on_device(centres + rough * rng.standard_normal(centres.shape)),
            on_device(angles + ROUGH * rng.standard_normal(angles.shape)),
        )
        return eqx.tree_at(
            lambda b: (b.exterior, b.interior, b.object_points), block, (exterior, now.interior, on_device(points))
        )

    def mistake(self, kind: str, rng: np.random.Generator) -> Mistake | None:
        """A mistake of a kind with rows drawn by chance; None where the block has no such rows."""
        made = KINDS[kind](self.truth, rng)
        if made is None:
            return None
        subjects, errors, fixed = made
        block = self.start.block
        residuals = [np.asarray(v) for v in self.start.weighted_residuals]
        tests = error_tests(block, residuals, [column for column, _ in errors])
        sizes = np.array([size for _, size in errors])
        controlled = float(sizes @ tests.matrix @ sizes)
        if controlled <= 0.02 * float(sizes**2 @ tests.lengths):
            return self.mistake(kind, rng)  # its residuals do not show it
        return Mistake(subjects, errors, self.root / np.sqrt(controlled), fixed)


def drawn(truth: Block, rng: np.random.Generator) -> Block:
    """The block with normal errors of all observations."""
    rays = np.asarray(truth.rays.coordinates)
    rays = rays + np.asarray(truth.rays.sigmas) * rng.standard_normal(rays.shape)
    groups = tuple(
        eqx.tree_at(
            lambda g: g.values,
            group,
            on_device(
                np.asarray(group.values)
                + np.where(group.structure.observed, np.asarray(group.sigmas), 0.0)
                * rng.standard_normal(group.values.shape)
            ),
        )
        for group in truth.groups
    )
    return eqx.tree_at(lambda b: (b.rays.coordinates, b.groups), truth, (on_device(rays), groups))


def outcome(start: Block, adjustment: Adjustment, mistake: Mistake) -> Outcome:
    """How the culprit was named; one that cannot be told apart from another counts as named.

    Where the tests of the residuals explain nothing, what `findings` looks for then counts: observations without which
    the block converges.
    """
    found = find_suspects(adjustment)
    named = [(s.subjects, *s.alternatives) for s in found.suspicions]
    if not named or found.sigma0 > BEYOND_USE:
        named = [((subject,),) for finding in causes(start, adjustment) for subject in finding.subjects] or named
    wanted = {(s.table, s.names) for s in mistake.subjects}
    right = [any(wanted >= _keys(subjects) or wanted <= _keys(subjects) for subjects in one) for one in named]
    return Outcome(bool(right[:1] and right[0]), any(right), sum(not r for r in right))


def _keys(subjects: tuple[Subject, ...]) -> set[tuple[str, tuple[str, ...]]]:
    return {(s.table, s.names) for s in subjects}


Made = tuple[tuple[Subject, ...], tuple[tuple[ErrorColumn, float], ...], bool]


def _unit(table: int, member: int, component: int) -> ErrorColumn:
    return ErrorColumn(table, np.array([member]), np.array([component]), np.ones(1))


def _control(block: Block) -> list[tuple[str, int, int]]:
    """Name, table and row of all control points."""
    s = block.structure
    fixed = [(s.point_names[p], FIXED, int(p)) for p in np.flatnonzero(~s.point_free.all(1))]
    for k, group in enumerate(block.groups, 1):
        if group.structure.kind.name == "control":
            fixed += [(s.point_names[p], k, row) for row, p in enumerate(group.structure.indices[:, 0])]
    return fixed


def _values(block: Block, table: int, row: int) -> np.ndarray:
    return np.asarray(block.object_points if table == FIXED else block.groups[table - 1].values)[row]


def control_coordinate(block: Block, rng: np.random.Generator) -> Made | None:
    """One coordinate of a control point is wrong."""
    control = _control(block)
    if not control:
        return None
    name, table, row = control[rng.integers(len(control))]
    return (Subject("control", (name,)),), ((_unit(table, row, int(rng.integers(3))), 1.0),), False


def control_point(block: Block, rng: np.random.Generator) -> Made | None:
    """All coordinates of a control point are wrong."""
    control = _control(block)
    if not control:
        return None
    name, table, row = control[rng.integers(len(control))]
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    return (Subject("control", (name,)),), tuple((_unit(table, row, k), float(direction[k])) for k in range(3)), False


def _ray(block: Block, rng: np.random.Generator) -> int:
    count = np.bincount(block.structure.ray_point)[block.structure.ray_point]
    return int(rng.choice(np.flatnonzero(count >= 3)))


def _subject(block: Block, ray: int) -> Subject:
    s = block.structure
    return Subject("rays", (s.image_names[s.ray_image[ray]], s.point_names[s.ray_point[ray]]))


def ray(block: Block, rng: np.random.Generator) -> Made | None:
    """A ray is off in any direction."""
    number, angle = _ray(block, rng), rng.uniform(0, 2 * np.pi)
    errors = (_unit(0, number, 0), float(np.cos(angle))), (_unit(0, number, 1), float(np.sin(angle)))
    return (_subject(block, number),), errors, False


def exchanged_pixels(block: Block, rng: np.random.Generator) -> Made | None:
    """x and y of a ray are exchanged."""
    if block.structure.cameras[0].image_unit != "px":
        return None
    number = _ray(block, rng)
    x, y = np.asarray(block.rays.coordinates)[number]
    # observed less true value: (y - x, x - y), y down; errors have y up
    errors = (_unit(0, number, 0), float(y - x)), (_unit(0, number, 1), -float(x - y))
    return (_subject(block, number),), errors, True


def exchanged_axes(block: Block, rng: np.random.Generator) -> Made | None:
    """X and Y of a control point are exchanged."""
    control = _control(block)
    if not control:
        return None
    name, table, row = control[rng.integers(len(control))]
    x, y, _ = _values(block, table, row)
    errors = (_unit(table, row, 0), float(y - x)), (_unit(table, row, 1), float(x - y))
    return (Subject("control", (name,)),), errors, True


def exchanged_names(block: Block, rng: np.random.Generator) -> Made | None:
    """The names of two control points are exchanged, or of two points on an image where there is no control."""
    control = _control(block)
    if not control:
        s, one = block.structure, _ray(block, rng)
        others = np.flatnonzero((s.ray_image == s.ray_image[one]) & (np.arange(len(s.ray_image)) != one))
        two = int(rng.choice(others))
        d = (np.asarray(block.rays.coordinates)[two] - np.asarray(block.rays.coordinates)[one]) * [1, -1]
        errors = [(_unit(0, one, k), float(d[k])) for k in range(2)] + [
            (_unit(0, two, k), -float(d[k])) for k in range(2)
        ]
        return (_subject(block, one), _subject(block, two)), tuple(errors), True
    (a, table_a, row_a), (b, table_b, row_b) = (control[k] for k in rng.choice(len(control), 2, replace=False))
    d = _values(block, table_b, row_b) - _values(block, table_a, row_a)
    errors = [(_unit(table_a, row_a, k), float(d[k])) for k in range(3)]
    errors += [(_unit(table_b, row_b, k), -float(d[k])) for k in range(3)]
    return (Subject("control", (a,)), Subject("control", (b,))), tuple(errors), True


def scale_bar(block: Block, rng: np.random.Generator) -> Made | None:
    """A distance is wrong."""
    for k, group in enumerate(block.groups, 1):
        if group.structure.kind.name == "distances":
            row = int(rng.integers(len(group.structure.indices)))
            names = tuple(block.structure.point_names[p] for p in group.structure.indices[row])
            return (Subject("distances", names),), ((_unit(k, row, 0), 1.0),), False
    return None


def shifted_control(block: Block, rng: np.random.Generator) -> Made | None:
    """All control points are shifted alike against the stations."""
    if not any(group.structure.kind.table == "stations" for group in block.groups):
        return None
    direction = np.eye(3)[rng.integers(3)]
    errors = [
        (_unit(table, row, k), float(direction[k]))
        for _, table, row in _control(block)
        for k in range(3)
        if direction[k]
    ]
    return (Subject("control"),), tuple(errors), False


def station(block: Block, rng: np.random.Generator) -> Made | None:
    """A coordinate of an observed station is wrong."""
    for k, group in enumerate(block.groups, 1):
        if group.structure.kind.table == "stations":
            row = int(rng.integers(len(group.structure.indices)))
            name = block.structure.image_names[group.structure.indices[row, 0]]
            return (Subject("stations", (name,)),), ((_unit(k, row, int(rng.integers(3))), 1.0),), False
    return None


KINDS: dict[str, Callable[[Block, np.random.Generator], Made | None]] = {
    f.__name__: f
    for f in (
        control_coordinate,
        control_point,
        ray,
        station,
        scale_bar,
        shifted_control,
        exchanged_names,
        exchanged_axes,
        exchanged_pixels,
    )
}


def drawn_outcome(
    simulated: Simulated, kind: str, multiple: float, rng: np.random.Generator
) -> tuple[Outcome, bool, Mistake] | None:
    """One draw, and whether its adjustment gave a result; None where the block has no such rows."""
    mistake = simulated.mistake(kind, rng)
    if mistake is None:
        return None
    start = simulated.given(rng, mistake, 1.0 if mistake.fixed else multiple * mistake.detectable)
    adjustment = adjust(start, max_iterations=ITERATIONS)
    result = adjustment.status is Status.CONVERGED and not adjustment.undetermined
    return outcome(start, adjustment, mistake), result, mistake
