"""Derivatives of the adjusted unknowns with respect to all input values, at the minimum (implicit function theorem).

    F(d; p) = v^T P v / 2 at the unknowns x corrected by d         p: observations, weights, control, fixed values, ...
    g(x, p) = dF/dd (0; p) = 0                                     defines x(p)
    dx = - H^-1 (dg/dp) dp,    H = d2F/dd2 (0; p)                  exact, or A^T P A alone (Gauss-Newton)

No iteration is differentiated. The equations are solved by the same elimination as in the adjustment. Forward and
transposed derivatives of any order follow from H and g, which are derivatives of a sum that JAX can differentiate
(`cost`).
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool

from jaxbundle.block.unknowns import Unknowns, corrected
from jaxbundle.normals.cost import cost, weighted_residuals
from jaxbundle.normals.problem import NormalVector, OrderedUnknowns, Problem, ReducedVector
from jaxbundle.normals.reduced_vector import correction_of
from jaxbundle.normals.solve_normals import solve_normals
from jaxbundle.numerics.compilation import Compiled

Derivatives = Literal["exact", "gauss-newton"]


@eqx.filter_custom_jvp
def minimum(
    found: OrderedUnknowns,
    start: OrderedUnknowns,
    p: Problem,
    converged: Bool[Array, ""],
    derivatives: Derivatives,
    optimised: bool,
) -> OrderedUnknowns:
    """`found` as a function of `p` and of the fixed elements of `start`; derivatives are NaN unless it converged."""
    return found


@minimum.def_jvp
def _minimum_jvp(primals: tuple, tangents: tuple) -> tuple[OrderedUnknowns, OrderedUnknowns]:
    _, start, p, converged, derivatives, optimised = primals
    x = minimum(*primals)
    given, given_dot = (start, p), tangents[1:3]
    _, g_dot = eqx.filter_jvp(lambda start, p: _gradient(x, start, p, optimised=optimised), given, given_dot)
    g_dot = NormalVector(*(z if g is None else g for g, z in zip(g_dot, zero_vector(p), strict=True)))
    sign = jnp.where(converged, -1.0, jnp.nan)
    d = _solve(x, start, p, jax.tree.map(lambda g: sign * g, g_dot), derivatives, optimised=optimised)

    def moved_by(start: OrderedUnknowns, d: NormalVector) -> OrderedUnknowns:
        return _moved(x, start, p, d, optimised=optimised)

    return x, eqx.filter_jvp(moved_by, (start, zero_vector(p)), (given_dot[0], d))[1]


def zero_vector(p: Problem) -> NormalVector:
    """A correction of zero."""
    return NormalVector(*(jnp.zeros(mask.shape) for mask in (*p.free, p.free_tiles)))


def moved(x: OrderedUnknowns, p: Problem, d: NormalVector) -> OrderedUnknowns:
    """The unknowns x after a correction, which does not change fixed elements."""
    o, free = p.observations, p.free
    step = ReducedVector(jnp.where(free.images, d.images, 0.0), jnp.where(free.border, d.border, 0.0))
    correction = correction_of(step, p, x)
    images = corrected(x.images, correction, o.in_angles, o.system)
    return OrderedUnknowns(images, x.tiles + jnp.where(p.free_tiles, d.tiles, 0.0))


@Compiled
def _moved(x: OrderedUnknowns, start: OrderedUnknowns, p: Problem, d: NormalVector) -> OrderedUnknowns:
    return moved(_held(x, start, p), p, d)


def _held(x: OrderedUnknowns, start: OrderedUnknowns, p: Problem) -> OrderedUnknowns:
    """The unknowns x with all fixed elements from the start."""
    o, u, first = p.observations, x.images, start.images
    free = o.exterior_free
    interior = jnp.zeros(u.interior.shape, bool)
    if o.columns:
        interior = interior.at[np.array(o.columns)].set(o.interior_free)
    rotation = jnp.where(free[3:].any(0), u.rotation, first.rotation)
    if o.in_angles is not None:
        angles = [o.system.angles_from_rotation(tuple(r)) for r in (u.rotation, first.rotation)]
        mixed = (jnp.where(f, a, b) for f, a, b in zip(free[3:], *angles, strict=True))
        rotation = jnp.where(o.in_angles, jnp.stack(o.system.rotation_from_angles(*mixed)), rotation)
    images = Unknowns(
        rotation,
        jnp.where(free[:3], u.centre, first.centre),
        jnp.where(interior, u.interior, first.interior),
        jnp.where(o.parameter_free, u.parameters, first.parameters),
        jnp.where(o.point_free[:, p.tile_points :], u.points, first.points),
    )
    return OrderedUnknowns(images, jnp.where(p.free_tiles, x.tiles, start.tiles))


def _cost(d: NormalVector, x: OrderedUnknowns, start: OrderedUnknowns, p: Problem) -> Array:
    """F."""
    return cost(moved(_held(x, start, p), p, d), p)


@Compiled
def _gradient(x: OrderedUnknowns, start: OrderedUnknowns, p: Problem) -> NormalVector:
    """g."""
    return jax.grad(_cost)(zero_vector(p), x, start, p)


@Compiled
def _solve(
    x: OrderedUnknowns, start: OrderedUnknowns, p: Problem, right: NormalVector, derivatives: Derivatives
) -> NormalVector:
    """Computes H^-1 b. The engine solves; further derivatives differentiate the product H d."""
    zero = zero_vector(p)
    flat, vector = ravel_pytree(
        right
    )  # one array: JAX has no transposed solution for parts that do not depend on the input

    def exact(d: Array) -> Array:
        return ravel_pytree(jax.jvp(lambda e: jax.grad(_cost)(e, x, start, p), (zero,), (vector(d),))[1])[0]

    def gauss_newton(d: Array) -> Array:
        def residuals(e: NormalVector) -> list[Array]:
            return weighted_residuals(moved(_held(x, start, p), p, e), p)

        _, along = jax.jvp(residuals, (zero,), (vector(d),))
        return ravel_pytree(jax.vjp(residuals, zero)[1](along)[0])[0]

    def by_elimination(_, b: Array) -> Array:
        right = jax.tree.map(lambda part: part[None], vector(b))
        return ravel_pytree(solve_normals(*constant, right, exact=derivatives == "exact"))[0]

    constant = lax.stop_gradient((_held(x, start, p), p))
    product = exact if derivatives == "exact" else gauss_newton
    return vector(lax.custom_linear_solve(product, flat, by_elimination, symmetric=True))
