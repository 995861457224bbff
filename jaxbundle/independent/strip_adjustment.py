"""The method of independent strips: strips joined from models, corrected by polynomials in one adjustment.

    v_geo  = x + T C - X_geo                   control
    v_bort = x_S + T(S) C + R - X_bort         navigation data with systematic errors R
    v_phot = x + T C - X                       all points of all strips; common points connect strips
    dX = T(p) C,   X = x + dX                  corrected points

Strips are pre-oriented by seven parameters each, in one adjustment. The method is less rigorous than models: errors
along a strip are only those of polynomials (Ackermann 1965).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Unpack

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.datum import is_located
from jaxbundle.block.findings import Finding, in_order
from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.independent import control_layout
from jaxbundle.independent.formation import Models
from jaxbundle.independent.joined import Strip, joined
from jaxbundle.independent.model_adjustment import fixed_interior, formed
from jaxbundle.independent.model_block import seen_points
from jaxbundle.independent.photograph_orientations import Oriented, with_orientations
from jaxbundle.independent.polynomials import Form, correction, curbed
from jaxbundle.independent.propagation import Propagated, all_errors, propagated, whitening
from jaxbundle.independent.sensor_block import SensorBlock
from jaxbundle.independent.sensors import lower_triangles
from jaxbundle.independent.started import started
from jaxbundle.independent.strip_block import (
    Frame,
    curb_group,
    end_errors,
    frames,
    normalised,
    polynomial_block,
    polynomial_sensors,
    rigid_block,
    strip_errors,
)
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.solve.adjust import Progress, adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.solve.options import Choices, Options

Names = Sequence[Sequence[str]]
CURBED = 0.5  # redundancy number of an expected size: below this, it determines the coefficient more than control does
STEP = 1e-4  # share of half of the length: differences of polynomials of degree 3 are exact to 1e-8


class Corrected(NamedTuple):
    """The corrected points of one strip."""

    point: Int[np.ndarray, " point"]
    coordinates: Float[np.ndarray, "point 3"]
    corrections: Float[np.ndarray, "point 3"]


class StripAdjustment(NamedTuple):
    """The result of the function `adjust_strips`.

    Example:
        >>> strips = jb.simulate(1, 5, control_rows=3, control_sigma=0.02).block
        >>> found = jb.independent.adjust_strips(strips)
        >>> found.adjustment.success, len(found.strips)
        (True, 1)
    """

    adjustment: Adjustment
    """The adjustment of the strips: its images are the strips, its interior elements are the coefficients, lengths in
    the object unit; its points are the object points, then the projection centres."""
    block: Block
    """The photographs with the orientations and points of the strips, as a start of another method."""
    oriented: Oriented
    """The exterior orientations, angles in radians; standard deviations of projection centres only."""
    points: Int[np.ndarray, " point"]
    """Indices of the object points of the strips in the block of photographs."""
    models: Models
    strips: tuple[Strip, ...]
    frames: tuple[Frame, ...]
    corrected: tuple[Corrected, ...]
    """The corrected points of each strip, and the corrections."""
    rigid: Adjustment
    """The first orientation of the strips, with seven parameters each."""
    findings: tuple[Finding, ...]

    @property
    def object_points(self) -> Float[np.ndarray, "point 3"]:
        """Adjusted coordinates of `points`."""
        return np.asarray(self.adjustment.block.object_points)[: len(self.points)]

    def propagated(self) -> Propagated | None:
        """Standard deviations from errors of image coordinates, accumulated along strips; None for a large block."""
        numbers = np.asarray(self.adjustment.block.rays.coordinates)[:, 3:9]
        rows = -whitening(lower_triangles(numbers)) @ strip_errors(self.strips, self.frames)
        return propagated(self.adjustment, all_errors(self.adjustment.block, rows))


def adjust_strips(
    block: Block,
    options: Options | None = None,
    *,
    degree: int = 2,
    form: Form = "separate",
    strips: Names | None = None,
    progress: Callable[[Progress], None] | None = None,
    **choices: Unpack[Choices],
) -> StripAdjustment:
    """Adjusts a block by the method of independent strips.

    Args:
        block: photographs, control or observed stations; its interior elements are fixed. Missing orientations are
            computed first, as by `approximate`.
        options: as for `adjust`, also as keywords.
        degree: degree of the polynomials, 2 or 3.
        form: "separate" polynomials of X, Y and Z; "plan-conformal", a complex one for X + iY and one for Z; or
            "conformal" in space, of degree 2.
        strips: names of the images of each strip in their order; if None, strips are determined.
        progress: a function that is called after each iteration.

    Returns: the adjustment of the strips, and the photographs with the adjusted orientations. `findings` reports
    missing control for these polynomials.

    Raises: BlockError for a block whose strips cannot be formed or that has no control; ValueError for another degree
    or form, or without float64.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxbundle as jb
        >>> found = jb.independent.adjust_strips(jb.simulate(1, 5, control_rows=3, control_sigma=0.02).block)
        >>> [len(strip.images) for strip in found.strips]
        [5]
    """
    require_a(Block, block, "independent.adjust_strips")
    prepare_jax()
    require_photographs(block, "independent.adjust_strips")
    if form not in ("separate", "plan-conformal", "conformal"):
        raise ValueError(f'the form of the polynomials is "separate", "plan-conformal" or "conformal", not {form!r}')
    if degree not in (2, 3) or (form == "conformal" and degree != 2):
        raise ValueError(f"polynomials of degree {degree}; give 2 or 3, and 2 for those that are conformal in space")
    if not is_located(block):
        cure = "give control or observed stations, or adjust by models or by the bundle method"
        raise BlockError([Problem("strips are corrected to control, and there is none", cure, "control")])
    block, of_start = started(block)
    models, told = formed(block, None if strips is None else _pairs(strips))
    found = _joined(block, models)
    names = tuple(f"strip {k + 1}" for k in range(len(found)))
    rigid = adjust(rigid_block(block, found, names).block, precision=False)
    in_frames = frames(rigid, found)
    how: tuple[Form, int] = form, degree
    ends = [end_errors(models, strip) for strip in found]
    sensors = polynomial_sensors(block, found, in_frames, names, how)
    of_strips = polynomial_block(block, found, in_frames, sensors, curb_group(ends, how))
    told = [*of_start, *told, *_layout(block, found, in_frames, degree)]
    adjustment = adjust(of_strips.block, options, progress=progress, **choices)
    oriented = _oriented(block, of_strips, in_frames, found, (adjustment, how))
    places = np.full(np.shape(block.object_points), np.nan)
    places[of_strips.points] = np.asarray(adjustment.block.object_points)[: len(of_strips.points)]
    told = [*told, *of_strips.findings, *fixed_interior(block), *_swinging(block, adjustment, found, ends, how)]
    return StripAdjustment(
        adjustment,
        with_orientations(block, oriented, places, adjustment.block.parameters),
        oriented,
        of_strips.points,
        models,
        found,
        in_frames,
        tuple(_corrected(k, adjustment, found, in_frames, how) for k in range(len(found))),
        rigid,
        in_order(told),
    )


def _pairs(strips: Names) -> list[tuple[str, str]]:
    return [pair for strip in strips for pair in zip(strip[:-1], strip[1:], strict=True)]


def _joined(block: Block, models: Models) -> tuple[Strip, ...]:
    """Strips of successive models."""
    seen = seen_points(block, models, whole=True)
    covariances = {m: seen.covariances[seen.sensor == m] for m in range(len(models))}
    chains: list[list[int]] = []
    for m in range(len(models)):
        if chains and models.pair[chains[-1][-1], 1] == models.pair[m, 0]:
            chains[-1].append(m)
        else:
            chains.append([m])
    rays = len(block.structure.ray_image)
    return tuple(strip for chain in chains for strip in joined(models, chain, covariances, rays))


def _ends(block: Block, strip: Strip) -> tuple[str, str]:
    """Names of the first and the last image."""
    names = block.structure.image_names
    return names[strip.images[0]], names[strip.images[-1]]


def _title(block: Block, k: int, strip: Strip) -> str:
    """Name of a strip for messages."""
    return f"strip {k + 1} (images {' to '.join(_ends(block, strip))})"


def _layout(block: Block, strips: tuple[Strip, ...], in_frames: tuple[Frame, ...], degree: int) -> list[Finding]:
    """Findings about missing control of the strips."""
    control, stations = control_layout.full_control(block), control_layout.observed_stations(block)
    times = np.bincount(np.concatenate([strip.points for strip in strips]), minlength=len(control))
    found = []
    for k, (strip, frame) in enumerate(zip(strips, in_frames, strict=True)):
        at, count = normalised(frame, frame.coordinates), len(strip.points)
        supported = control_layout.Supported(
            at[:count, 0],
            at[:count, 3],
            control[strip.points],
            times[strip.points] > 1,
            at[count:, 0][stations[strip.images]],
            tuple(block.structure.point_names[p] for p in strip.points),
            (frame.origin + frame.coordinates[:count] @ frame.axes.T)[:, :2],
        )
        found += control_layout.missing_control(_title(block, k, strip), supported, degree + 1, _ends(block, strip))
    return found


def _swinging(
    block: Block, adjustment: Adjustment, strips: tuple[Strip, ...], ends: list[dict[str, float]], how: tuple[Form, int]
) -> list[Finding]:
    """Findings about coefficients that are determined by their expected sizes and not by control."""
    if adjustment.redundancy_numbers is None:
        return []
    r, found = np.asarray(adjustment.redundancy_numbers[-1]), []
    names, terms = adjustment.block.structure.cameras[0].model.elements, curbed(*how)
    for k, strip in enumerate(strips):
        weak = [name for name in terms if r[k, names.index(name)] < CURBED]
        if weak:
            end = max(ends[k][terms[name][0]] for name in weak)
            unit = block.structure.object_unit
            found.append(control_layout.swinging(_title(block, k, strip), weak, end, unit, _ends(block, strip)))
    return found


def _corrections(
    frame: Frame, coefficients: Float[np.ndarray, " element"], how: tuple[Form, int], x: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point 3"]:
    """Corrections T C in the system of the strip."""
    t = correction(*how, tuple(coefficients), tuple(normalised(frame, x).T))
    return np.stack([np.broadcast_to(c, len(x)) for c in t], 1)


def _corrected(
    k: int, adjustment: Adjustment, strips: tuple[Strip, ...], in_frames: tuple[Frame, ...], how: tuple[Form, int]
) -> Corrected:
    frame, strip = in_frames[k], strips[k]
    x = frame.coordinates[: len(strip.points)]
    dx = _corrections(frame, np.asarray(adjustment.block.interior.elements)[k], how, x) @ frame.axes.T
    return Corrected(strip.points, frame.origin + x @ frame.axes.T + dx, dx)


def _oriented(
    block: Block,
    of_strips: SensorBlock,
    in_frames: tuple[Frame, ...],
    strips: tuple[Strip, ...],
    end: tuple[Adjustment, tuple[Form, int]],
) -> Oriented:
    """Projection centres, which are points; attitudes are rotated like the ground by the polynomials.

    Its slopes dZ/dy and -dZ/dx are rotations about x and y, half of the curl in plan is one about z.
    """
    adjustment, how = end
    count, points = len(block.structure.image_names), len(of_strips.points)
    exterior, sd = np.full((count, 6), np.nan), np.full((count, 6), np.nan)
    exterior[of_strips.images, :3] = np.asarray(adjustment.block.object_points)[points:]
    if adjustment.cofactors is not None:
        sd[of_strips.images, :3] = np.asarray(adjustment.standard_deviations.object_points)[points:]
    system, coefficients = block.structure.rotation_system, np.asarray(adjustment.block.interior.elements)
    for k, (strip, frame) in enumerate(zip(strips, in_frames, strict=True)):
        x, h = frame.coordinates[len(strip.points) :], STEP * frame.half_length
        x = x * [1.0, 1.0, 0.0]  # below the images, on the mean ground
        at = [[_corrections(frame, coefficients[k], how, x + s * h * e) for s in (1, -1)] for e in np.eye(3)[:2]]
        by_x, by_y = ((after - before) / (2 * h) for after, before in at)
        turn = np.stack([by_y[:, 2], -by_x[:, 2], (by_x[:, 1] - by_y[:, 0]) / 2], 1)
        turned = frame.axes @ _rotations(turn) @ frame.rotation
        found = [[float(a) for a in system.angles_from_rotation(tuple(r.ravel()))] for r in turned]
        near = np.asarray(block.exterior.angles)[strip.images]
        exterior[strip.images, 3:] = np.array(found) + 2 * np.pi * np.round((near - np.array(found)) / (2 * np.pi))
    return Oriented(exterior, sd)


def _rotations(turn: Float[np.ndarray, "image 3"]) -> Float[np.ndarray, "image 3 3"]:
    """Rotation matrices of small rotation vectors."""
    x, y, z = turn.T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
    left, _, right = np.linalg.svd(np.eye(3) + skew + skew @ skew / 2)
    return left @ right
