"""Solving the undamped equations for arbitrary right-hand sides: N^-1 b and H^-1 b.

    [ U    W ] [t]   [b_t]        u = V^-1 b_X                               images' rows:  S t = b_t - W u
    [ W^T  V ] [X] = [b_X]        X = V^-1 (b_X - W^T t)

N = A^T P A, or with all second derivatives of v^T P v / 2, H = N + sum of w^2 v d2v, which has the same blocks. One
elimination is used for all right-hand sides. N^-1 is used for variances of functions of the unknowns and for the
S-transformation of free networks, H^-1 for derivatives of the adjusted unknowns.
"""

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float

from jaxbundle.normals.chunks import EVERYWHERE, over_devices
from jaxbundle.normals.eliminate import eliminate
from jaxbundle.normals.normal_products import to_images, to_points
from jaxbundle.normals.pcg import ImplicitEquations
from jaxbundle.normals.plan.layout import EXTERIOR
from jaxbundle.normals.point_blocks import PointFactor, backward, forward, point_equations
from jaxbundle.normals.problem import Linearised, NormalVector, OrderedUnknowns, Problem, ReducedVector
from jaxbundle.normals.reduced_system import ReducedFactor, factorise, solve
from jaxbundle.normals.reduced_vector import reduced_rows, values_along
from jaxbundle.normals.step import linearise, reduced_system
from jaxbundle.numerics.devices import AXIS


def solve_normals(unknowns: OrderedUnknowns, p: Problem, right: NormalVector, exact: bool = False) -> NormalVector:
    """Computes N^-1 b for each vector of the leading axis, H^-1 b if `exact`; not finite if not positive definite."""
    of_tiles: Any = PartitionSpec(None, None, AXIS)
    vectors = NormalVector(EVERYWHERE, EVERYWHERE, of_tiles)
    return over_devices(_on_device, linearise(unknowns, p, exact), vectors, (right,), (vectors,))


def _on_device(linear: Linearised, right: NormalVector) -> NormalVector:
    return lax.map(_factorised(linear).solve, right)


def inverse_products(unknowns: OrderedUnknowns, p: Problem, b: NormalVector) -> Float[Array, "vector vector"]:
    """Products b^T N^-1 b of all pairs of vectors of the leading axis, on one device, without back-substitution.

    b^T N^-1 b = r^T S^-1 r + b_X^T V^-1 b_X,    r = b_t - W V^-1 b_X
    """
    return over_devices(_inverse_products, linearise(unknowns, p), EVERYWHERE, (b,))


def _inverse_products(linear: Linearised, b: NormalVector) -> Float[Array, "vector vector"]:
    factorised = _factorised(linear)

    def forward_solution(b: NormalVector) -> tuple[ReducedVector, ReducedVector, Float[Array, "3 tile column"]]:
        u = factorised.eliminated(b.tiles)
        r = factorised.condensed(b, u)
        return r, factorised.reduced_solution(r), u

    r, t, u = lax.map(forward_solution, b)
    pairs = (r.images, t.images), (r.border, t.border), (b.tiles, u)
    parts = [jnp.einsum("fa,ga->fg", *(x.reshape(len(x), -1) for x in pair)) for pair in pairs]
    products = parts[0] + parts[1] + parts[2]
    return (products + products.T) / 2


class _Factorised(NamedTuple):
    """The factorised equations of one device."""

    linear: Linearised
    reduced: ReducedFactor | ImplicitEquations
    points: PointFactor

    def solve(self, b: NormalVector) -> NormalVector:
        """The solution for one right-hand side."""
        t = self.reduced_solution(self.condensed(b, self.eliminated(b.tiles)))
        at_points = to_points(self.linear, values_along(t, self.linear))
        return NormalVector(t.images, t.border, self.eliminated(b.tiles - at_points))

    def condensed(self, b: NormalVector, u: Float[Array, "3 tile column"]) -> ReducedVector:
        """b_t - W u."""
        coupled = reduced_rows(self.linear.total(to_images(self.linear, u)), self.linear)
        return ReducedVector(b.images - coupled.images, b.border - coupled.border)

    def reduced_solution(self, right: ReducedVector) -> ReducedVector:
        """S^-1 r."""
        if isinstance(self.reduced, ImplicitEquations):
            return self.reduced.solve(right)
        solver = self.linear.problem.reduced
        images, border = solve(solver, self.reduced, right.images[..., None], right.border[:, None])
        return ReducedVector(images[..., 0], border[:, 0])

    def eliminated(self, b: Float[Array, "3 tile column"]) -> Float[Array, "3 tile column"]:
        """V^-1 b."""
        return jnp.stack(backward(self.points, forward(self.points, (b[0], b[1], b[2]))))


def _factorised(linear: Linearised) -> _Factorised:
    """Eliminates the points of this device and factorises the reduced equations."""
    zero = jnp.zeros(())
    rays, stored = eliminate(linear, zero)
    rays = linear.total(rays)
    linear = _with_second_rotations(linear, rays.rotation)
    system = reduced_system(rays, linear).system
    points = point_equations(stored, linear.width).factor
    if linear.problem.layout.implicit:
        return _Factorised(linear, ImplicitEquations(linear, system, stored, zero), points)
    return _Factorised(linear, factorise(linear.problem.reduced, system, zero), points)


def _with_second_rotations(linear: Linearised, gradient: Float[Array, "image 9"] | None) -> Linearised:
    """Adds the second derivatives of the rotations times the gradient of the rays with respect to the matrices."""
    if gradient is None or linear.d2_rotation is None:
        return linear
    bent = jnp.einsum("ie,eabi->iab", gradient, linear.d2_rotation)
    angles = slice(3, EXTERIOR)
    diagonal = linear.sums.diagonal.at[:, angles, angles].add(bent)
    return dataclasses.replace(linear, sums=linear.sums._replace(diagonal=diagonal))
