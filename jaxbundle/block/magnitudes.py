"""Checking the magnitudes of numbers: too large or too small for double precision, many full turns, zero lengths.

Such numbers are finite, but their squares overflow, their differences lose all digits, or directions are undefined.
Each table is reported once, with its first row and the number of rows. Parameters and constants that are not finite,
and covariance matrices that are not positive definite, are reported row by row.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.block.problems import Problem
from jaxbundle.block.wording import RADIANS

LARGEST = 1e12  # maximum of a coordinate in its unit (double precision then resolves 0.0001), and of sigmas
SMALLEST = 1e-12  # minimum of a sigma in its unit, radians for angles; far more precise than any instrument
MAX_TURNS = 10  # of an angle: theodolites count few turns, and large angles lose digits
LEVEL = ("azimuths", "directions", "horizontal_distances", "zenith_angles")  # kinds that need a horizontal distance
SLOPE = ("distances", "scale_bars")  # kinds that need a distance in space


def absurd_numbers(block: Block) -> list[Problem]:
    """Problems of implausible magnitudes in a consistent block of finite numbers."""
    return [*_out_of_range(block), *_turned(block), *_without_length(block)]


def _told(rows: Bool[np.ndarray, " row"], table: str, what: str, cure: str) -> Iterator[Problem]:
    """One problem for all rows of a table; `what` describes the first one."""
    wrong = np.flatnonzero(rows)
    if len(wrong):
        more = f", and of {len(wrong) - 1} more rows" if len(wrong) > 1 else ""
        yield Problem(f"{what}{more}", cure, table, int(wrong[0]))


def _out_of_range(block: Block) -> Iterator[Problem]:
    """Problems of coordinates, sigmas, interior elements and times."""
    s = block.structure
    tables = [
        ("images", "projection centre", block.exterior.projection_centre),
        ("points", "approximate coordinate", block.object_points),
        ("cameras", "interior element", block.interior.elements),
        ("rays", "image coordinate", block.rays.coordinates),
        ("check_points", "coordinate", block.check_points.coordinates),
    ]
    sigmas: list[tuple[str, Any]] = [("rays", block.rays.sigmas)]
    for group in block.groups:
        kind = group.structure.kind
        tables += [(kind.table, "observed value", group.values), (kind.table, "constant", group.constants)]
        sigmas.append((kind.table, group.sigmas if group.covariances is None else np.sqrt(_variances(group))))
    for table, name, values in tables:
        size = np.abs(np.asarray(values, float))
        rows = (size > LARGEST).any(1)
        if rows.any():
            row = int(np.argmax(rows))
            what = f"the {name} {np.asarray(values)[row][size[row] > LARGEST][0]:.3g} is beyond {LARGEST:.0e}"
            yield from _told(
                np.asarray(rows), table, what, f"correct it: in {s.object_unit} or px no survey has such coordinates"
            )
    for table, values in sigmas:
        values = np.asarray(values, float)
        out = (values < SMALLEST) | (values > LARGEST)
        if out.any():
            what = f"the standard deviation {values[out][0]:.3g} lies outside {SMALLEST:.0e} to {LARGEST:.0e}"
            cure = "give the accuracy of the measurement; fix a value without error instead"
            yield from _told(np.asarray(out.any(1)), table, what, cure)


def _variances(group: ObservationGroup) -> Float[np.ndarray, "member component"]:
    """Sigmas of the observed components; 1 for the others."""
    variances = np.diagonal(np.asarray(group.covariances), axis1=1, axis2=2)
    return np.where(group.structure.observed, variances, 1.0)


def _turned(block: Block) -> Iterator[Problem]:
    """Problems of angles with many full turns."""
    unit = block.structure.angle_unit
    tables = [("images", np.asarray(block.exterior.angles))]
    for group in block.groups:
        if group.structure.kind.angles:
            tables.append((group.structure.kind.table, np.asarray(group.values)))
    for table, angles in tables:
        out = np.abs(angles) > MAX_TURNS * 2 * np.pi
        if out.any():
            first = angles[out][0] / RADIANS.get(unit, 1.0)
            what = f"the angle {first:.10g} {unit} makes more than {MAX_TURNS} full turns"
            yield from _told(
                np.asarray(out.any(1)), table, what, f"give it within one full turn, and check that it is in {unit}"
            )


def _without_length(block: Block) -> Iterator[Problem]:
    """Problems of azimuths and distances between ends with equal approximate values: their direction is undefined."""
    ends = {"point": np.asarray(block.object_points), "image": np.asarray(block.exterior.projection_centre)}
    names = {"point": block.structure.point_names, "image": block.structure.image_names}
    for group in block.groups:
        kind, indices = group.structure.kind, group.structure.indices
        if kind.name not in (*LEVEL, *SLOPE) or len(indices) == 0:
            continue
        start, end = (ends[kind.touches[k]][indices[:, k]] for k in range(2))
        axes = 2 if kind.name in LEVEL else 3
        length = np.linalg.norm((end - start)[:, :axes], axis=1)
        rounding = 4 * np.finfo(float).eps * np.maximum(np.abs(start), np.abs(end)).max(1)
        rows = length <= rounding
        if rows.any():
            row = int(np.argmax(rows))
            a, b = (names[kind.touches[k]][indices[row, k]] for k in range(2))
            same = "X and Y" if axes == 2 else "coordinates"
            what = (
                f"{a} and {b} have the same approximate {same}, so the {kind.components[0]} between them is undefined"
            )
            cure = "correct the names or the approximate coordinates; vertical points belong to a plumb line"
            yield from _told(rows, kind.table, what, cure)


def repeated_rows(block: Block) -> tuple[Finding, ...]:
    """The finding about rows that repeat another row to the last digit. All are used as observations."""
    found = []
    for group in block.groups:
        kind = group.structure.kind
        rows = np.column_stack([group.structure.indices, np.asarray(group.values), np.asarray(group.sigmas)])
        repeats = len(rows) - len(np.unique(rows, axis=0))
        if repeats:
            count = (
                f"{repeats} row of {kind.table} repeats" if repeats == 1 else f"{repeats} rows of {kind.table} repeat"
            )
            found.append(
                Finding(
                    Kind.INFORMATION,
                    f"{count} another one to the last digit; each counts as a separate observation",
                    "drop the copies: they make the standard deviations too small",
                    (Subject(kind.table),),
                    float(repeats),
                    "rows",
                )
            )
    return tuple(found)


def unusable_numbers(block: Block) -> list[Problem]:
    """Problems of parameters and constants that are not finite, and of invalid covariances, in a concrete block."""
    s, found = block.structure, []
    for k in np.flatnonzero(~np.isfinite(np.asarray(block.parameters))):
        found.append(
            Problem(f"parameter {s.parameters[k].name} is not a finite number", "give it an approximate value")
        )
    for group in block.groups:
        kind = group.structure.kind
        for row in np.flatnonzero(~np.isfinite(np.asarray(group.constants)).all(1)):
            what = f"one of {', '.join(kind.constants)} is not a finite number"
            found.append(Problem(what, "give the number or drop the row", kind.table, int(row)))
        for row in _indefinite(group):
            what = "the covariance matrix is not positive definite"
            found.append(Problem(what, "give a covariance matrix with positive eigenvalues", kind.table, int(row)))
    return found


def _indefinite(group: ObservationGroup) -> Sequence[int]:
    """Indices of members whose observed components do not have a positive definite covariance matrix."""
    if group.covariances is None:
        return []
    observed = group.structure.observed
    both = observed[:, :, None] & observed[:, None, :]
    matrices = np.where(both, np.asarray(group.covariances), np.eye(observed.shape[1]))
    finite = np.asarray(np.isfinite(matrices).all((1, 2)))
    safe = np.where(finite[:, None, None], matrices, np.eye(observed.shape[1]))
    roots = np.sqrt(np.maximum(np.diagonal(safe, axis1=1, axis2=2), np.finfo(float).tiny))
    smallest = np.linalg.eigvalsh(safe / roots[:, :, None] / roots[:, None, :])[:, 0]
    # eigenvalues of the correlation matrix: rounding alone may make one of them smaller than this
    return np.flatnonzero(~(finite & (smallest > np.finfo(float).eps))).tolist()
