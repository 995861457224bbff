"""The orientation of one image from three points: all solutions and their reliability."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Real

from jaxbundle.geometry.vectors import Vector
from jaxbundle.numerics.nested import Nested
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.orientation.three_points import Triple, three_point_solutions

ON_A_LINE = 1e-3  # ratio of the area of the triangle and the square of its longest side
ON_CYLINDER = 1e-2  # determinant: below this an error of a direction is enlarged more than 100 times


class ThreePointResection(eqx.Module):
    """Up to four solutions, in the first axis; NaN for missing ones.

    Example:
        >>> points = [[0, 0, 0], [90, 0, 5], [0, 99, 0]]
        >>> found = jb.orientation.three_point_resection(points, [[-30, -40, -200], [70, -40, -200], [-30, 60, -195]])
        >>> int(np.isfinite(found.distances[:, 0]).sum())
        4
    """

    rotation: Float[Array, "*image 4 3 3"]
    """Rotation matrices object_from_image."""
    projection_centre: Float[Array, "*image 4 3"]
    """Projection centres in the unit of the object points."""
    distances: Float[Array, "*image 4 3"]
    """Distances from the projection centre to each of the points."""
    determinant: Float[Array, "*image 4"]
    """Volume between -1 and 1 spanned by the rows of the linearised law of cosines; 0 on the danger cylinder."""
    exact: Bool[Array, "*image 4"]
    """Whether it is a solution; otherwise the real part of a complex pair, near the danger cylinder."""
    flatness: Float[Array, "*image"]
    """Ratio of the area of the triangle and the square of its longest side; 0 for points on a line."""

    @property
    def count(self) -> Array:
        """Number of exact solutions."""
        return self.exact.sum(-1)

    @property
    def words(self) -> str:
        """Problem and cure of the solutions of one image (concrete results only); empty if there is none."""
        if self.flatness < ON_A_LINE:
            return "the three points lie on a line and do not determine the image; choose points of a larger triangle"
        weak = np.abs(self.determinant) < ON_CYLINDER
        if (weak & np.asarray(self.exact)).any() or (not self.exact.any() and np.isfinite(self.determinant).any()):
            return (
                "the projection centre lies near the danger cylinder through the three points, where two solutions"
                " coincide and are not accurate; choose other points"
            )
        return "" if self.exact.any() else "no projection centre fits these three points; check their names"


def three_point_resection(
    object_points: Real[ArrayLike, "3 3"] | Nested, directions: Real[ArrayLike, "3 3"] | Nested
) -> ThreePointResection:
    """Computes all orientations of an image with three points in given directions.

    Args:
        object_points: X, Y, Z of the points, one row per point.
        directions: rays in the system of the photograph, one row per point, such as (x, y, -c); any length.

    Returns: up to four solutions. It works with jit and vmap.

    Raises: ValueError for other shapes, or without float64.

    Example:
        >>> import jaxbundle as jb
        >>> points = [[0, 0, 0], [100, 0, 0], [0, 100, 5]]
        >>> found = jb.orientation.three_point_resection(points, [[-30, -40, -200], [70, -40, -200], [-30, 60, -195]])
        >>> np.round(found.projection_centre[found.exact], 6)[1]
        Array([ 30.,  40., 200.], dtype=float64)
    """
    prepare_jax()
    if np.shape(object_points) != (3, 3) or np.shape(directions) != (3, 3):
        raise ValueError(
            f"object points of shape {np.shape(object_points)} and directions of shape {np.shape(directions)}; give"
            " three coordinates for each of three points"
        )
    return _resection(jnp.asarray(object_points, float), jnp.asarray(directions, float))


@jax.jit
def _resection(points: Float[Array, "3 3"], directions: Float[Array, "3 3"]) -> ThreePointResection:
    directions = directions / jnp.linalg.norm(directions, axis=1, keepdims=True)
    origin = points.mean(0)  # large coordinates lose digits
    found = three_point_solutions(_triple(points - origin[None]), _triple(directions), jnp.zeros((), int))
    sides = points - jnp.roll(points, 1, 0)
    area = 0.5 * jnp.linalg.norm(jnp.cross(sides[0], sides[1]))
    return ThreePointResection(
        jnp.stack(found.rotation, -1).reshape(4, 3, 3),
        jnp.stack(found.centre, -1) + origin[None],
        jnp.stack(found.distances, -1),
        jnp.asarray(found.determinant),
        found.exact,
        area / jnp.max(jnp.sum(sides * sides, 1)),
    )


def _triple(rows: Float[Array, "3 3"]) -> Triple:
    def vector(row: Array) -> Vector:
        return row[0], row[1], row[2]

    return vector(rows[0]), vector(rows[1]), vector(rows[2])
