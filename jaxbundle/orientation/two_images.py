"""Rotation and base of two images from an essential matrix or a homography.

X2 = R X1 + t. An essential matrix E = [t]x R has two rotations and a base of unknown sign (Horn 1990, eqs. 17 and 24):

    t t^T = tr(E E^T) / 2 I - E E^T,        t^2 R = cof E - [t]x E

A homography H = R + t n^T of a plane with normal n, scaled to a second singular value of 1, has two solutions and their
opposites (Ma, Soatto, Kosecka, Sastry 2004, sec. 5.3.3). With v_k the right singular vectors and S_k the squared
singular values:

    u+- = (sqrt(1 - S3) v1 +- sqrt(S1 - 1) v3) / sqrt(S1 - S3)
    U = [v2, u, v2 x u],  W = [H v2, H u, H v2 x H u],  R = W U^T,  n = v2 x u,  t = (H - R) n
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxbundle.geometry.polynomial import all_roots

SMALL = 1e-30  # instead of a squared base of 0
REAL = 1e-8  # imaginary part over 1 + |x| of a real root: rounding


def cross_matrix(t: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The skew-symmetric matrix [t]x of a vector."""
    zero = jnp.zeros(())
    return jnp.stack([zero, -t[2], t[1], t[2], zero, -t[0], -t[1], t[0], zero]).reshape(3, 3)


def cofactor_matrix(m: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """The cofactor matrix: the determinant times the transposed inverse."""
    return jnp.stack([jnp.cross(m[1], m[2]), jnp.cross(m[2], m[0]), jnp.cross(m[0], m[1])])


def motions_from_essential(e: Float[Array, "3 3"]) -> tuple[Float[Array, "4 3 3"], Float[Array, "4 3"]]:
    """The four pairs of rotation and base."""
    square = e @ e.T
    outer = 0.5 * jnp.trace(square) * jnp.eye(3) - square
    k = jnp.argmax(jnp.diagonal(outer))
    t = outer[k] / jnp.sqrt(jnp.maximum(outer[k, k], SMALL))
    length, cofactors, product = jnp.maximum(t @ t, SMALL), cofactor_matrix(e), cross_matrix(t) @ e
    one, two = (cofactors - product) / length, (cofactors + product) / length
    return jnp.stack([one, one, two, two]), jnp.stack([t, -t, t, -t])


def homography(first: Float[Array, "4 3"], second: Float[Array, "4 3"]) -> Float[Array, "3 3"]:
    """The matrix with second ~ H first for four pairs of rays; not finite if three of them are in a plane."""
    a, b = cofactor_matrix(first[:3]), cofactor_matrix(second[:3])  # rows: inverse of the columns up to a factor
    factors = (b @ second[3]) / (a @ first[3])
    return (second[:3].T * factors[None]) @ a


def motions_from_homography(
    h: Float[Array, "3 3"],
) -> tuple[Float[Array, "4 3 3"], Float[Array, "4 3"], Float[Array, "4 3"]]:
    """The four rotations, bases in units of the distance of the plane, and normals of the plane."""
    h = h * jnp.sign(jnp.linalg.det(h))
    values, v = jnp.linalg.eigh(h.T @ h)
    h, s1, s3 = h / jnp.sqrt(values[1]), values[2] / values[1], values[0] / values[1]
    v1, v2, v3 = v[:, 2], v[:, 1], v[:, 0]
    spread = jnp.sqrt(jnp.maximum(s1 - s3, SMALL))
    a, b = jnp.sqrt(jnp.maximum(1 - s3, 0.0)) / spread, jnp.sqrt(jnp.maximum(s1 - 1, 0.0)) / spread
    found = []
    for sign in (1.0, -1.0):
        u = a * v1 + sign * b * v3
        n = jnp.cross(v2, u)
        w = jnp.stack([h @ v2, h @ u, jnp.cross(h @ v2, h @ u)], 1)
        r = w @ jnp.stack([v2, u, n], 1).T
        t = (h - r) @ n
        found += [(r, t, n), (r, -t, -n)]
    rotations, bases, normals = (jnp.stack(part) for part in zip(*found, strict=True))
    return rotations, bases, normals


def distances(
    rotation: Float[Array, "3 3"], base: Float[Array, "3"], first: Float[Array, "ray 3"], second: Float[Array, "ray 3"]
) -> tuple[Float[Array, " ray"], Float[Array, " ray"], Float[Array, " ray"]]:
    """Distances along both unit vectors to the closest points of the rays, and squared sines of their angles.

    X2 = R X1 + t. The distances are multiplied by the squared sine, which preserves their sign and avoids a division.
    """
    y = first @ rotation.T
    a, yt, dt = jnp.sum(y * second, 1), y @ base, second @ base
    return a * dt - yt, dt - a * yt, jnp.sum(jnp.cross(y, second) ** 2, 1)


def eight_points(first: Float[Array, "point 2"], second: Float[Array, "point 2"]) -> Float[Array, "3 3"]:
    """The essential matrix of eight or more pairs of image coordinates, with Frobenius norm sqrt 2 (Hartley 1997).

    (second, 1)^T E (first, 1) = 0 in units of the principal distance. In the linear solution, with coordinates of mean
    0 and size sqrt 2, the singular values are replaced by a, a, 0. Points in a plane do not determine it.
    """
    one, two = _conditioned(first), _conditioned(second)
    rows = (two[0][:, :, None] * one[0][:, None, :]).reshape(-1, 9)
    e = jnp.linalg.svd(rows)[2][-1].reshape(3, 3)
    e = two[1].T @ e @ one[1]
    u, _, vt = jnp.linalg.svd(e)
    return (u * jnp.array([[1.0, 1.0, 0.0]])) @ vt


def seven_points(
    first: Float[Array, "7 2"], second: Float[Array, "7 2"]
) -> tuple[Float[Array, "3 3 3"], Bool[Array, "3"]]:
    """The fundamental matrices of seven pairs of image coordinates, of Frobenius norm 1, and which are real.

    (second, 1)^T F (first, 1) = 0 in any units; the interior orientations need not be known. Of the two matrices A, B
    that satisfy the seven equations those combinations are taken whose determinant vanishes,

        det(A + x B) = det A + x tr(adj(A) B) + x^2 tr(adj(B) A) + x^3 det B = 0

    (Hartley, Zisserman 2004, sec. 11.1.2). Three roots are real, or one.
    """
    one, two = _conditioned(first), _conditioned(second)
    rows = (two[0][:, :, None] * one[0][:, None, :]).reshape(7, 9)
    a, b = jnp.linalg.qr(rows.T, mode="complete")[0].T[7:].reshape(2, 3, 3)

    of_a, of_b = cofactor_matrix(a), cofactor_matrix(b)  # tr(adj(A) B) is the sum of cof(A) times B
    x = all_roots(jnp.stack([jnp.sum(of_a * a) / 3, jnp.sum(of_a * b), jnp.sum(of_b * a), jnp.sum(of_b * b) / 3]))
    f = two[1].T @ (a[None] + x.real[:, None, None] * b[None]) @ one[1]
    return f / jnp.linalg.norm(f, axis=(1, 2), keepdims=True), jnp.abs(x.imag) < REAL * (1 + jnp.abs(x))


def _conditioned(xy: Float[Array, "point 2"]) -> tuple[Float[Array, "point 3"], Float[Array, "3 3"]]:
    """Homogeneous coordinates relative to their mean, with size sqrt 2, and the matrix of this reduction."""
    mean = xy.mean(0)
    scale = jnp.sqrt(2.0) / jnp.sqrt(jnp.mean(jnp.sum((xy - mean[None]) ** 2, 1)))
    matrix = jnp.eye(3).at[0, 0].set(scale).at[1, 1].set(scale).at[:2, 2].set(-scale * mean)
    return jnp.concatenate([xy, jnp.ones((xy.shape[0], 1))], 1) @ matrix.T, matrix
