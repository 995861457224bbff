"""Solving the reduced normal equations without forming them: preconditioned conjugate gradients.

    S x = U x - W u + lambda D x,    u = V^-1 W^T x        products of `normal_products`

One product needs one pass through all tiles, like the back-substitution. The preconditioner are the diagonal blocks of
S, one per image and one for the whole border.

It is for blocks whose factor would be too large or too dense. It gives no cofactors.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbundle.normals.normal_products import reduced_product
from jaxbundle.normals.problem import Linearised, ReducedSums, ReducedVector
from jaxbundle.normals.reduced_system import ReducedFactor, ReducedSystem, factorise, solve
from jaxbundle.normals.reduced_vector import reduced_rows, values_along
from jaxbundle.numerics.conjugate_gradients import conjugate_gradients

TOLERANCE = 1e-12  # share of the first residual, in the norm of the preconditioner
MAX_ITERATIONS = 2000


class ImplicitEquations(NamedTuple):
    """The reduced equations of one device."""

    linear: Linearised
    system: ReducedSystem
    stored: Float[Array, "tile value"]
    """The equations of the points of this device."""
    damping: Array

    def solve(self, right: ReducedVector) -> ReducedVector:
        """Solves S x = r by conjugate gradients."""
        right, precondition = self.only_free(right), self.preconditioned()
        return conjugate_gradients(self.product, precondition, right, ReducedVector.dot, TOLERANCE, MAX_ITERATIONS)[0]

    def preconditioned(self) -> Callable[[ReducedVector], ReducedVector]:
        """Computes M^-1 r with the diagonal blocks M of S."""
        factor = self.preconditioner()

        def precondition(r: ReducedVector) -> ReducedVector:
            images, border = solve(self.linear.problem.reduced, factor, r.images[..., None], r.border[:, None])
            return ReducedVector(images[..., 0], border[:, 0])

        return precondition

    def preconditioner(self) -> ReducedFactor:
        """The factors of the diagonal blocks."""
        # with the coupling, but without the blocks of pairs of images, it might not be positive definite
        diagonal = eqx.tree_at(lambda s: s.coupling, self.system, jnp.zeros_like(self.system.coupling))
        return factorise(self.linear.problem.reduced, diagonal, self.damping)

    def only_free(self, x: ReducedVector) -> ReducedVector:
        """The vector with 0 for fixed unknowns."""
        free = ReducedVector(self.system.free, self.system.border_free)
        return jax.tree.map(lambda f, v: jnp.where(f, v, 0.0), free, x)

    def product(self, x: ReducedVector) -> ReducedVector:
        """Computes the product S x."""
        linear, system = self.linear, self.system
        rows = reduced_product(linear, values_along(x, linear), self.stored)
        of_rays = reduced_rows(linear.total(rows), linear)
        damped = ReducedVector(system.diagonal * x.images, system.border_diagonal * x.border)
        damped = jax.tree.map(lambda v: self.damping * v, damped)
        return self.only_free(jax.tree.map(lambda *v: sum(v), sums_product(linear.sums, x), of_rays, damped))


def sums_product(sums: ReducedSums, x: ReducedVector) -> ReducedVector:
    """The part of S x from observations other than rays of the tiles."""
    images = jnp.einsum("iab,ib->ia", sums.diagonal, x.images) + sums.coupling @ x.border
    border = jnp.einsum("iab,ia->b", sums.coupling, x.images) + sums.border @ x.border
    return ReducedVector(images, border)
