"""Minimises a BAL file by scipy's trust region, sparse Jacobian by autodiff; prints the mean time of an iteration."""

import sys
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import scipy.sparse as sp  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402

from jaxbundle.block.residuals import observations_of, ray_residuals  # noqa: E402
from jaxbundle.block.unknowns import Correction, corrected, unknowns_of  # noqa: E402
from jaxbundle.io import read_bal  # noqa: E402

block = read_bal(sys.argv[1])
start, o = unknowns_of(block), observations_of(block)
images, points, rays = start.centre.shape[1], start.points.shape[1], o.ray_image.shape[0]


def moved(x: jax.Array):
    """The unknowns after corrections x: 6 and 3 an image, 3 a point."""
    exterior, interior = x[: 6 * images].reshape(6, images), x[6 * images : 9 * images].reshape(3, images)
    correction = Correction(exterior, interior, jnp.zeros(0), x[9 * images :].reshape(3, points))
    return corrected(start, correction, None, o.system)


@jax.jit
def residuals(x: jax.Array) -> jax.Array:
    """All residuals, x and y of ray after ray."""
    return ray_residuals(moved(x), o).T.ravel()


def rows(x: jax.Array) -> jax.Array:
    """The non-zero derivatives of every ray: 9 of its image, 3 of its point."""

    def one(local: jax.Array) -> jax.Array:  # (12, ray): every ray with unknowns of its own
        u = moved(x)
        image, point = o.ray_image, o.ray_point
        own = type(u)(u.rotation[:, image], u.centre[:, image], u.interior[:, image], u.parameters, u.points[:, point])
        own = corrected(own, Correction(local[:6], local[6:9], jnp.zeros(0), local[9:]), None, o.system)
        n = jnp.arange(rays)
        apart = type(o)(
            o.model, o.columns, o.system, n, n, n, o.coordinates, o.weights, (), o.exterior_free, o.interior_free,
            o.parameter_free, o.point_free, None,
        )  # fmt: skip
        return ray_residuals(own, apart)

    zero = jnp.zeros((12, rays))
    units = [jnp.zeros((12, rays)).at[k].set(1.0) for k in range(12)]
    return jnp.stack([jax.jvp(one, (zero,), (unit,))[1] for unit in units])


compiled_rows = jax.jit(rows)
image, point = np.asarray(o.ray_image), np.asarray(o.ray_point)
columns = np.stack([k * images + image for k in range(9)] + [9 * images + k * points + point for k in range(3)])


def jacobian(x: np.ndarray) -> sp.csr_matrix:
    """The sparse Jacobian."""
    values = np.asarray(compiled_rows(jnp.asarray(x)))
    row = np.arange(2 * rays).reshape(rays, 2).T
    index = np.broadcast_to(row, values.shape).ravel(), np.broadcast_to(columns[:, None], values.shape).ravel()
    return sp.csr_matrix((values.ravel(), index), (2 * rays, 9 * images + 3 * points))


x0 = np.zeros(9 * images + 3 * points)
residuals(jnp.asarray(x0))  # compiles
jacobian(x0)
begin = time.perf_counter()
answer = least_squares(
    lambda x: np.asarray(residuals(jnp.asarray(x))),
    x0,
    jacobian,  # pyright: ignore[reportArgumentType]
    method="trf",
    x_scale="jac",
    tr_solver="lsmr",
    max_nfev=20,
)
print("iteration", (time.perf_counter() - begin) / answer.nfev)
print("cost", repr(float(answer.cost)))
