"""The reduced normal equations solved without being formed: preconditioned conjugate gradients.

    S x = U x - W u + lambda D x,    u = V^-1 W^T x        products of `ray_products`

One product runs through all tiles once, like the back-substitution. The preconditioner are the diagonal blocks of S,
one an image and one for the whole border.

For blocks whose factor would be too large or too full. It gives no cofactors.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.cells import Tiles
from jaxbundle.normals.kept import KeptSums
from jaxbundle.normals.kept_vector import KeptVector, correction_of, direction_of, kept_rows
from jaxbundle.normals.ray_products import reduced_product
from jaxbundle.normals.reduced_system import ReducedFactor, ReducedSystem, factorise, solve
from jaxbundle.normals.substitute import image_values
from jaxbundle.numerics.conjugate_gradients import conjugate_gradients

TOLERANCE = 1e-12  # of the first residual, in the norm of the preconditioner
MOST_ITERATIONS = 2000


class ImplicitEquations(NamedTuple):
    """The reduced equations as one device has them; `factors`: of its points, `exact`: with all second derivatives."""

    unknowns: Arranged
    turns: Float[Array, "9 3 image"]
    kept: KeptSums
    system: ReducedSystem
    factors: Float[Array, "tile numbers"]
    damping: Array
    problem: Problem
    tiles: tuple[Tiles, ...]
    axis: str | None
    exact: bool = False

    def solve(self, right: KeptVector) -> KeptVector:
        """S^-1 r."""
        right, precondition = self.only_free(right), self.preconditioned()
        return conjugate_gradients(self.product, precondition, right, KeptVector.dot, TOLERANCE, MOST_ITERATIONS)[0]

    def preconditioned(self) -> Callable[[KeptVector], KeptVector]:
        """M^-1 r, with the diagonal blocks M of S."""
        factor = self.preconditioner()

        def precondition(r: KeptVector) -> KeptVector:
            images, border = solve(self.problem.reduced, factor, r.images[..., None], r.border[:, None])
            return KeptVector(images[..., 0], border[:, 0])

        return precondition

    def preconditioner(self) -> ReducedFactor:
        """The factors of the diagonal blocks."""
        # with the coupling, but without the blocks of pairs of images, it might not be positive
        diagonal = eqx.tree_at(lambda s: s.coupling, self.system, jnp.zeros_like(self.system.coupling))
        return factorise(self.problem.reduced, diagonal, self.damping)

    def only_free(self, x: KeptVector) -> KeptVector:
        """The vector with 0 for what is held."""
        free = KeptVector(self.system.free, self.system.border_free)
        return jax.tree.map(lambda f, v: jnp.where(f, v, 0.0), free, x)

    def product(self, x: KeptVector) -> KeptVector:
        """S x."""
        p, o, system = self.problem, self.problem.observations, self.system
        before = image_values(self.unknowns.images, o)
        direction = image_values(direction_of(correction_of(x.images, x.border, p, self.unknowns), self.turns), o)
        rows = reduced_product(o, before, direction, self.unknowns.tiles, self.factors, self.tiles, self.exact)
        of_rays = kept_rows(lax.psum(rows, self.axis) if self.axis else rows, self.turns, p)
        damped = KeptVector(system.diagonal * x.images, system.border_diagonal * x.border)
        damped = jax.tree.map(lambda v: self.damping * v, damped)
        return self.only_free(jax.tree.map(lambda *v: sum(v), kept_product(self.kept, x), of_rays, damped))


def kept_product(kept: KeptSums, x: KeptVector) -> KeptVector:
    """The part of S x that is no ray of an eliminated point."""
    images = jnp.einsum("iab,ib->ia", kept.diagonal, x.images) + kept.coupling @ x.border
    border = jnp.einsum("iab,ia->b", kept.coupling, x.images) + kept.border @ x.border
    return KeptVector(images, border)
