"""Further columns of control.csv: covariances of the coordinates, and the category of the target.

cXY,cXZ,cYZ    covariances of the observed coordinates, empty = 0
category       how well the point is identified on an image: [identification] gives its standard deviation in the
               unit of the rays, which is added to those of all rays of the point: s^2 = s_ray^2 + s_category^2
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.problems import shown
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.ranges import LARGEST_COVARIANCE
from jaxbundle.io.tables import Table

COVARIANCES = ("cXY", "cXZ", "cYZ")
PLACES = ((0, 1), (0, 2), (1, 2))  # of the covariances in the matrix
OPTIONAL = (*COVARIANCES, "category")


def covariances(
    table: Table, sigmas: Float[np.ndarray, "row 3"], observed: Bool[np.ndarray, "row 3"]
) -> Float[np.ndarray, "row 3 3"] | None:
    """Covariance matrices of the coordinates, 1 on the diagonal of what is not observed; None where none is given."""
    given = table.numbers(*COVARIANCES, largest=LARGEST_COVARIANCE)
    if not np.isfinite(given).any():
        return None
    matrices = np.where(observed, sigmas, 1.0)[:, :, None] ** 2 * np.eye(3)
    for (a, b), column, values in zip(PLACES, COVARIANCES, given.T, strict=True):
        known = np.isfinite(values)
        x, y = column[1:]
        rows = np.flatnonzero(known & ~(observed[:, a] & observed[:, b]))
        table.note(rows, f"{column} is given, but not both sigmas of observed {x} and {y}", "give them, or drop it")
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
    """Standard deviation of the identification of each object point; 0 where its category is not given."""
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
        "give its standard deviation there, correct the name or leave it empty",
    )
    return deviations
