"""Cofactors of the unknowns at the minimum: blocks of N^-1.

Q_kk = (U - E^T E)^-1                      kept unknowns
Q_pp = V^-1 + G Q_kk G^T,  G = L^-T E      an eliminated point, 3 x 3
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.normals import reduced
from jaxbundle.normals.plan import Plan
from jaxbundle.normals.point_blocks import PointFactor, backward, forward
from jaxbundle.normals.schur import Tables, _groups, _Sums, eliminate, eliminate_chunk, free_columns


class Cofactors(NamedTuple):
    """Cofactors of all unknowns, 0 where an element is held, and the weakest share of each (0: undetermined)."""

    kept: Float[Array, "kept kept"]
    points: Float[Array, "3 3 point"]
    kept_pivots: Float[Array, " kept"]
    point_pivots: Float[Array, " point"]


def cofactors(t: Tables, plan: Plan) -> Cofactors:
    """Cofactors of the undamped normal equations; not finite where these are singular."""
    zero = jnp.asarray(0.0)
    size, points = plan.size, t.observations.point_free.shape[1]
    e = eliminate(t, plan, zero)
    factor = reduced.factorise(e.reduced, e.diagonal, zero, free_columns(t.observations, plan))
    q = reduced.inverse(factor)
    _, point_sums = _groups(
        t, plan, _Sums(jnp.zeros((size + 1, size + 1)), jnp.zeros(size + 1)), jnp.zeros((9, points + 1))
    )

    def add_chunk(c: Array, store: Array) -> Array:
        chunk = eliminate_chunk(t, plan, point_sums, zero, c)
        n = chunk.point.shape[0]
        coupling = chunk.coupling[:, :size].reshape(n, 3, size)
        factor_of_rows = PointFactor(*(f[:, None] for f in chunk.factor))
        g = jnp.stack(backward(factor_of_rows, (coupling[:, 0], coupling[:, 1], coupling[:, 2])), 1)
        spread = jnp.einsum("nik,njk->ijn", (g.reshape(3 * n, size) @ q).reshape(n, 3, size), g)
        return store.at[:, :, chunk.point].set(spread + _inverse(chunk.factor))

    eliminated = lax.fori_loop(0, plan.ray.shape[0], add_chunk, jnp.zeros((3, 3, points + 1)))[:, :, :points]
    first = plan.point_column[plan.kept_point][:, None] + jnp.arange(3)
    blocks = q[first[:, :, None], first[:, None, :]].transpose(1, 2, 0)
    return Cofactors(q, eliminated.at[:, :, plan.kept_point].set(blocks), factor.pivots, _point_pivots(t, e, plan))


def _inverse(factor: PointFactor) -> Float[Array, "3 3 point"]:
    """V^-1 = L^-T L^-1."""
    one, zero = jnp.ones_like(factor.i0), jnp.zeros_like(factor.i0)
    units = ((one, zero, zero), (zero, one, zero), (zero, zero, one))
    columns = [backward(factor, forward(factor, unit)) for unit in units]
    return jnp.stack([jnp.stack(column) for column in columns], 1)


def _point_pivots(t: Tables, e, plan: Plan) -> Float[Array, " point"]:
    """Smallest share of a coordinate's own normal equation left within its point; 1 for held and kept points."""
    shares = []
    for k in range(3):
        free = t.observations.point_free[k] & (e.factor[k] != 0)
        shares.append(jnp.where(free, 1 / jnp.where(free, e.factor[k] ** 2 * e.point_diagonal[k], 1.0), 1.0))
    return jnp.min(jnp.stack(shares), 0)
