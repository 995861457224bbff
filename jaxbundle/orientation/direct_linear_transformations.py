"""The direct linear transformation: an image with unknown interior (Abdel-Aziz, Karara 1971).

    x ~ P X,    P = K R^T [I | -X0],    K = [-c  s  x0;  0  -c'  y0;  0  0  1]

Each point gives two linear equations for the twelve elements of P. The solution is the right singular vector of
the minimum singular value, in coordinates with mean 0 and equal scale (Hartley 1997). K and R come from the first three
columns. Then Gauss-Newton steps on the image coordinates give the least-squares solution and its cofactors. Points in
one plane do not determine it.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Real

from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem, from_rotation_vector
from jaxbundle.numerics.host import is_concrete
from jaxbundle.numerics.nested import Nested
from jaxbundle.numerics.program_cache import prepare_jax

MIN_POINTS = 6  # eleven unknowns, two equations per point
IN_A_PLANE = 1e-4  # ratio of minimum and maximum eigenvalue of the scatter of the points
DEGENERATE = 1e-6  # ratio of the eleventh and the first singular value of the linear equations
STEPS = 10


class DirectLinearTransformation(eqx.Module):
    """Interior and exterior orientation of an image; lengths in the image in the unit of its coordinates.

    Example:
        >>> x = np.array([[0, 0, 0], [9, 0, 1], [0, 9, 2], [9, 9, 4], [4, 5, 3], [2, 7, 0.5]])
        >>> found = jb.orientation.direct_linear_transformation(x, -100 * (x[:, :2] - 4) / (x[:, 2:] - 20))
        >>> np.round(found.principal_distances, 6), bool(found.determined)
        (Array([100., 100.], dtype=float64), True)
    """

    projection_centre: Float[Array, "3"]
    """Projection centre in the unit of the object points."""
    angles: Float[Array, "3"]
    """The angles in radians."""
    rotation: Float[Array, "3 3"]
    """Matrix object_from_image."""
    principal_distances: Float[Array, "2"]
    """Principal distances c in x and c' in y; they are equal for square pixels."""
    skew: Float[Array, ""]
    """Shear s, 0 for orthogonal axes."""
    principal_point: Float[Array, "2"]
    """x0, y0."""
    cofactors: Float[Array, "11 11"]
    """Cofactors of c, c', s, x0, y0, X0, Y0, Z0 and three small angles about the axes of the object system."""
    residuals: Float[Array, "point 2"]
    """Residuals computed - observed, in the unit of the coordinates."""
    sigma0: Float[Array, ""]
    """Standard deviation of unit weight; NaN without redundancy."""
    flatness: Float[Array, ""]
    """Ratio of minimum and maximum eigenvalue of the scatter of the points: 0 for points in a plane."""
    determined: Bool[Array, ""]
    """Whether the points determine all eleven elements."""
    mirrored: Bool[Array, ""]
    """Whether only a mirrored image fits the points."""

    @property
    def standard_deviations(self) -> Float[Array, "11"]:
        """Standard deviations of the eleven elements in the order of the cofactors."""
        return self.sigma0 * jnp.sqrt(jnp.diagonal(self.cofactors))

    @property
    def words(self) -> str:
        """Problem and cure of the result (concrete results only); empty if there is none."""
        if self.flatness < IN_A_PLANE:
            return (
                "the points lie in a plane, which does not determine the interior orientation; add points off the"
                " plane, or use planar_resection with a known interior"
            )
        if not self.determined:
            return "the points do not determine the eleven elements; add points that are spread in space"
        return "only a mirrored image fits the points; check the sign of the y coordinates" if self.mirrored else ""


class _Elements(NamedTuple):
    """The five elements of K, R and X0."""

    interior: Float[Array, "5"]
    rotation: Float[Array, "3 3"]
    centre: Float[Array, "3"]


def direct_linear_transformation(
    object_points: Real[ArrayLike, "point 3"] | Nested,
    coordinates: Real[ArrayLike, "point 2"] | Nested,
    sigma: float = 1.0,
    *,
    system: RotationSystem = OMEGA_PHI_KAPPA,
) -> DirectLinearTransformation:
    """Computes interior and exterior orientation of an image from at least six points in space.

    Args:
        object_points: X, Y, Z, one row per point; not in one plane.
        coordinates: measured x, y, y up, one row per point; any origin.
        sigma: standard deviation of an image coordinate.
        system: rotation system of the angles.

    Returns: the orientation with its precision. It works with jit and vmap.

    Raises: ValueError for fewer than six points, other shapes, values that are not finite, or without float64.

    Example:
        >>> import numpy as np, jaxbundle as jb
        >>> x = np.array([[0, 0, 0], [9, 0, 1], [0, 9, 2], [9, 9, 4], [4, 5, 3], [2, 7, 0.5]])
        >>> found = jb.orientation.direct_linear_transformation(x, -100 * (x[:, :2] - 4) / (x[:, 2:] - 20))
        >>> np.round(found.projection_centre, 6)
        Array([ 4.,  4., 20.], dtype=float64)
    """
    prepare_jax()
    count = np.shape(object_points)[0] if np.ndim(object_points) else 0
    if np.shape(object_points) != (count, 3) or np.shape(coordinates) != (count, 2):
        raise ValueError(
            f"object points of shape {np.shape(object_points)} and image coordinates of shape {np.shape(coordinates)};"
            " give X, Y, Z and x, y of each point"
        )
    if count < MIN_POINTS:
        raise ValueError(f"{count} points do not determine eleven elements; measure at least 6, better 10")
    points, xy = jnp.asarray(object_points, float), jnp.asarray(coordinates, float)
    if is_concrete((points, xy)) and not (np.isfinite(points).all() and np.isfinite(xy).all()):
        raise ValueError("a coordinate is not a finite number; leave the point out")
    return _transformation(system, points, xy, jnp.asarray(sigma, float))


@eqx.filter_jit
def _transformation(system: RotationSystem, points: Array, xy: Array, sigma: Array) -> DirectLinearTransformation:
    x, origin, size = _normalised(points)
    m, shift, scale = _normalised(xy)
    p, determined = _linear(x, m)
    scatter = jnp.linalg.eigvalsh(x.T @ x)
    start, mirrored = _taken_apart(p, x)
    at = jax.lax.fori_loop(0, STEPS, lambda _, at: _changed(at, _correction(at, x, m)[0]), start)
    _, normals, v = _correction(at, x, m)
    # back to the units of the user: the interior grows with the image, the centre with the object
    factor = jnp.concatenate([jnp.full(5, scale), jnp.full(3, size), jnp.ones(3)])
    redundancy = 2 * points.shape[0] - 11
    cofactors = jnp.linalg.inv(normals) * factor[:, None] * factor[None] * (sigma / scale) ** 2
    c, c2, s, x0, y0 = at.interior
    residuals = v.reshape(-1, 2) * scale
    sigma0 = jnp.sqrt(jnp.sum((residuals / sigma) ** 2) / redundancy) if redundancy else jnp.asarray(jnp.nan)
    return DirectLinearTransformation(
        at.centre * size + origin,
        jnp.stack(system.angles_from_rotation(tuple(at.rotation.ravel()))),
        at.rotation,
        jnp.stack([c, c2]) * scale,
        s * scale,
        jnp.stack([x0, y0]) * scale + shift,
        cofactors,
        residuals,
        sigma0,
        scatter[0] / scatter[-1],
        determined & (scatter[0] > IN_A_PLANE * scatter[-1]),
        mirrored,
    )


def _normalised(values: Array) -> tuple[Array, Array, Array]:
    """Values relative to their mean with a mean square of 1 in each coordinate, the mean and the scale."""
    mean = values.mean(0)
    size = jnp.sqrt(jnp.mean((values - mean[None]) ** 2))
    return (values - mean[None]) / size, mean, size


def _linear(x: Array, m: Array) -> tuple[Float[Array, "3 4"], Bool[Array, ""]]:
    """Solves the linear equations for P, and checks whether they determine it."""
    h = jnp.concatenate([x, jnp.ones((x.shape[0], 1))], 1)
    zero = jnp.zeros_like(h)
    rows = jnp.concatenate([jnp.concatenate([h, zero, -m[:, :1] * h], 1), jnp.concatenate([zero, h, -m[:, 1:] * h], 1)])
    _, values, vt = jnp.linalg.svd(rows, full_matrices=False)
    return vt[-1].reshape(3, 4), values[10] > DEGENERATE * values[0]


def _taken_apart(p: Float[Array, "3 4"], x: Array) -> tuple[_Elements, Bool[Array, ""]]:
    """Decomposes P into K, R and X0, with points in front of the camera, and checks whether R is a reflection."""
    centre = -jnp.linalg.solve(p[:, :3], p[:, 3])
    q, r = jnp.linalg.qr(p[::-1, :3].T)
    k, rotation = r.T[::-1, ::-1], q.T[::-1]
    signs = jnp.stack([-jnp.sign(k[0, 0]), -jnp.sign(k[1, 1]), jnp.sign(k[2, 2])])
    k, rotation = k * signs[None], signs[:, None] * rotation  # rows: R^T
    front = jnp.sum((x - centre[None]) @ rotation[2] < 0) * 2 >= x.shape[0]
    turn = jnp.where(front, 1.0, -1.0)
    # P and -P are equivalent: the third axis and, to preserve K, the others change their sign
    rotation = turn * rotation
    mirrored = jnp.linalg.det(rotation) < 0
    k = k / k[2, 2]
    rotation = jnp.where(mirrored, rotation * jnp.array([[1.0], [-1.0], [1.0]]), rotation)
    return _Elements(jnp.stack([-k[0, 0], -k[1, 1], k[0, 1], k[0, 2], k[1, 2]]), rotation.T, centre), mirrored


def _changed(at: _Elements, d: Float[Array, "11"]) -> _Elements:
    turn = jnp.stack(from_rotation_vector(d[8], d[9], d[10])).reshape(3, 3)
    return _Elements(at.interior + d[:5], turn @ at.rotation, at.centre + d[5:8])


def _correction(at: _Elements, x: Array, m: Array) -> tuple[Array, Array, Array]:
    """The Gauss-Newton step, N and the residuals."""

    def residuals(d: Array) -> Array:
        e = _changed(at, d)
        c, c2, s, x0, y0 = e.interior
        p = (x - e.centre[None]) @ e.rotation
        u, v = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
        return (jnp.stack([x0 - c * u + s * v, y0 - c2 * v], 1) - m).ravel()

    v, a = residuals(jnp.zeros(11)), jax.jacfwd(residuals)(jnp.zeros(11))
    normals = a.T @ a
    return -jnp.linalg.solve(normals, a.T @ v), normals, v
