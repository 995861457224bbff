"""Tables with known coordinates and angles: points.csv, control.csv, stations.csv and attitudes.csv.

cXY, cXZ, cYZ of control.csv are covariances of the observed coordinates. Its `category` describes how well the point
is identified on an image: [identification] gives the standard deviation of each category in the unit of the rays. It is
    added to those of all rays of the point: s^2 = s_ray^2 + s_category^2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.problems import shown
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.schema import Holds
from jaxbundle.io.tables import Table, positions_of, where

COVARIANCES = ("cXY", "cXZ", "cYZ")
PLACES = ((0, 1), (0, 2), (1, 2))  # positions of the covariances in the matrix
KNOWN = ("points", "control", "stations", "attitudes")
ROLES = ("control", "check")


@dataclass(frozen=True)
class KnownRows:
    """Coordinates of points or images, or angles; NaN where not given.

    `covariances` of control points; None where the coordinates are not correlated.
    """

    table: Table
    names: tuple[str, ...]
    position: Int[np.ndarray, " row"]
    coordinates: Float[np.ndarray, "row 3"]
    sigmas: Float[np.ndarray, "row 3"]
    check: Bool[np.ndarray, " row"]
    covariances: Float[np.ndarray, "row 3 3"] | None = None

    @property
    def held(self) -> Bool[np.ndarray, "row 3"]:
        """Mask of coordinates with sigma 0, which are fixed."""
        return self._takes_part & (self.sigmas == 0)

    @property
    def observed(self) -> Bool[np.ndarray, "row 3"]:
        """Mask of coordinates with a weight."""
        return self._takes_part & (self.sigmas > 0)

    @property
    def members(self) -> Int[np.ndarray, " member"]:
        """Mask of rows with a weighted coordinate."""
        return np.flatnonzero(self.observed.any(1))

    @property
    def _takes_part(self) -> Bool[np.ndarray, "row 3"]:
        return ((self.position >= 0) & ~self.check)[:, None] & np.isfinite(self.coordinates)


def known_rows(table: Table, points: Sequence[str], images: Sequence[str], images_file: str) -> KnownRows:
    """Reads one of these tables; `images_file` is the file that defines the images."""
    kind, schema = table.schema.name, table.schema
    if schema.of(Holds.IMAGE):
        known, position = table.text["image"], table.positions("image", images, images_file)
        table.unique("image")
    else:  # a point may be on no image
        known = table.names("point")
        position = positions_of(known, points)
        _one_role(table) if kind == "control" else table.unique("point")
    columns = schema.of(Holds.VALUE)
    coordinates, sigmas = table.numbers(*columns), np.full((len(known), 3), np.nan)
    if schema.of(Holds.SIGMA):
        sigmas = table.sigmas(*schema.of(Holds.SIGMA))
        for k, name in enumerate(columns):
            rows = np.flatnonzero((sigmas[:, k] == 0) & np.isnan(coordinates[:, k]))
            table.note(rows, f"s{name} = 0 fixes {name}, which is not given", f"give {name} or leave s{name} empty")
    check, together = np.zeros(len(known), bool), None
    if kind == "control":
        check = _check(table)
        together = _covariances(table, sigmas, np.isfinite(coordinates) & (sigmas > 0))
    return KnownRows(table, tuple(known), position, coordinates, sigmas, check, together)


def _check(table: Table) -> Bool[np.ndarray, " row"]:
    """Mask of the rows of check points; a missing or unknown role is noted."""
    role = table.text["role"].str.to_lowercase()
    table.note(where(role == ""), "role is not given", f"give one of {', '.join(ROLES)}")
    unknown = where(~role.is_in(["", *ROLES]))
    table.note(unknown, lambda row: f"role '{shown(role[row])}' is unknown", f"known: {', '.join(ROLES)}")
    return (role == "check").to_numpy()


def _one_role(table: Table) -> None:
    """Notes control points that occur in two rows, with the same role or with two roles."""
    rows, first = table.repeated("point")
    role = table.text["role"].str.to_lowercase()
    roles = dict(zip(rows.tolist(), zip(role.gather(first), table.lines[first].tolist(), strict=True), strict=True))
    two = (role.gather(rows) != role.gather(first)).to_numpy()
    for kind, what in (
        (rows[~two], lambda row: f"is already in line {roles[row][1]}"),
        (rows[two], lambda row: f"is {role[row]} here and {roles[row][0]} in line {roles[row][1]}"),
    ):
        table.note(kind, what, "drop one of the two")


def _covariances(
    table: Table, sigmas: Float[np.ndarray, "row 3"], observed: Bool[np.ndarray, "row 3"]
) -> Float[np.ndarray, "row 3 3"] | None:
    """Covariance matrices of the coordinates, with 1 on the diagonal if not observed; None where none is given."""
    given = table.numbers(*COVARIANCES)
    if not np.isfinite(given).any():
        return None
    matrices = np.where(observed, sigmas, 1.0)[:, :, None] ** 2 * np.eye(3)
    for (a, b), column, values in zip(PLACES, COVARIANCES, given.T, strict=True):
        known = np.isfinite(values)
        x, y = column[1:]
        rows = np.flatnonzero(known & ~(observed[:, a] & observed[:, b]))
        table.note(
            rows,
            f"{column} is given, but not both sigmas of observed {x} and {y}",
            "give both, or drop the covariance",
        )
        both = np.where(known & observed[:, a] & observed[:, b], values, 0.0)
        matrices[:, a, b] = matrices[:, b, a] = both
    scale = 1 / np.sqrt(np.diagonal(matrices, axis1=1, axis2=2))
    smallest = np.linalg.eigvalsh(scale[:, :, None] * matrices * scale[:, None, :])[:, 0]
    what = "the covariance matrix of its coordinates is not positive definite"
    cure = "each covariance must be smaller than the product of its two sigmas; correct them"
    table.note(np.flatnonzero(~(smallest > len(PLACES) * np.finfo(float).eps)), what, cure)
    return matrices


def identification(
    table: Table, point: Int[np.ndarray, " row"], points: int, toml: BlockToml
) -> Float[np.ndarray, " point"]:
    """Standard deviation of the identification of each object point; 0 for points without category."""
    known = (toml.settings.identification if toml.settings else None) or {}
    deviations, unknown = np.zeros(points), []
    categories = table.column("category").to_list()
    for row, category in enumerate(categories):
        if category in known and point[row] >= 0:
            deviations[point[row]] = known[category]
        elif category and category not in known and toml.settings is not None:
            unknown.append(row)
    table.note(
        unknown,
        lambda row: f"category '{shown(categories[row])}' is not in [identification] of {FILE}",
        "add its standard deviation there, correct the name or leave it empty",
    )
    return deviations
