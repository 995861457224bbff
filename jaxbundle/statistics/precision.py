"""Precision of functions of the unknowns, error ellipses, and precision by groups.

    C_ff = sigma0^2 F Q F^T,    F = df/d(unknowns) by autodiff

Q F^T comes from the factorised normal equations, one pass through the tiles a function; Q is never formed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.given import require_a
from jaxbundle.block.unknowns import angle_derivatives, unknowns_of
from jaxbundle.normals.arrange import Arranged, Arrangement, Problem, arrange, arranged_unknowns, problem
from jaxbundle.normals.solution import solve_normals
from jaxbundle.normals.vector import NormalVector, arranged_vectors
from jaxbundle.numerics.compilation import RAYS_FOR_OPTIMISATION, Compiled
from jaxbundle.numerics.host import on_device
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.solve.free_network import carrying_places, with_inner_constraints


class Estimated(NamedTuple):
    """Values of functions of the unknowns, their a-posteriori covariance matrix and standard deviations."""

    values: Float[np.ndarray, " function"]
    covariance: Float[np.ndarray, "function function"]

    @property
    def standard_deviations(self) -> Float[np.ndarray, " function"]:
        """Square roots of the variances."""
        return np.sqrt(np.diagonal(self.covariance))


class Ellipsoids(NamedTuple):
    """Semi-axes, longest first, and their directions, the columns; of one standard deviation in every direction."""

    semi_axes: Float[np.ndarray, "point axis"]
    directions: Float[np.ndarray, "point coordinate axis"]


def covariance_of(adjustment: Adjustment, function: Callable[[Block], Array]) -> Estimated:
    """Values and covariance of a differentiable function of the adjusted block: a vector, or one number.

    What is held in the block counts as errorless.

    Raises: ValueError for a solution that has no factorisation, by conjugate gradients.
    """
    require_a(Adjustment, adjustment, "covariance_of")
    if adjustment.reduced == "pcg":
        raise ValueError("conjugate gradients give no variances: adjust with another solver")
    adjusted = adjustment.block

    def vector(block: Block) -> Float[Array, " function"]:
        return jnp.atleast_1d(jnp.asarray(function(block)))

    values, derivatives = vector(adjusted), jax.jacrev(vector, allow_int=True)(adjusted)
    block = with_datum(adjusted)
    centres = np.asarray(block.exterior.projection_centre)
    centred = block.moved(on_device(-centres.mean(0)))
    plan = arrange(block.structure, block.groups, centres, 1, "auto", True)
    args = arranged_unknowns(plan, unknowns_of(centred)), problem(plan, centred)
    rows = _arranged_rows(plan, block, derivatives)
    inner = block.structure.datum.constraints
    carrying = carrying_places(block.structure, plan) if inner else None
    optimised = len(block.structure.ray_image) >= RAYS_FOR_OPTIMISATION
    cofactors = _cofactors(*args, rows, carrying, inner, optimised=optimised)
    return Estimated(np.asarray(values), float(adjustment.sigma0) ** 2 * np.asarray(cofactors))


@Compiled
def _cofactors(
    unknowns: Arranged, p: Problem, rows: NormalVector, carrying: Float[Array, " place"] | None, constraints: int
) -> Float[Array, "function function"]:
    """F Q F^T."""
    if carrying is not None:
        rows = with_inner_constraints(unknowns, p, carrying, constraints, rows)
    q = solve_normals(unknowns, p, rows)
    products = [jnp.einsum("fa,ga->fg", *(x.reshape(len(x), -1) for x in pair)) for pair in zip(rows, q, strict=True)]
    found = sum(products[1:], products[0])
    return (found + found.T) / 2


def _arranged_rows(plan: Arrangement, block: Block, derivatives: Any) -> NormalVector:
    """F in the order of elimination, by the angles of the corrections."""
    structure, unknowns = block.structure, unknowns_of(block)
    turned = np.asarray(angle_derivatives(unknowns.rotation, None, block.exterior.angles.T, structure.rotation_system))
    by_angles = np.einsum("fia,abi->fib", np.asarray(derivatives.exterior.angles), turned)
    by_centre = np.asarray(derivatives.exterior.projection_centre)
    by_interior = np.asarray(derivatives.interior.elements)[:, :, list(structure.interior_columns)]
    rows = arranged_vectors(
        plan,
        structure,
        np.concatenate([by_centre, by_angles], 2),
        by_interior,
        np.asarray(derivatives.parameters),
        np.asarray(derivatives.object_points),
    )
    return NormalVector(*map(on_device, rows))


def error_ellipsoids(adjustment: Adjustment) -> Ellipsoids:
    """Of all object points, a posteriori.

    Raises: ValueError where no cofactors were computed.
    """
    require_a(Adjustment, adjustment, "error_ellipsoids")
    if adjustment.cofactors is None:
        raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
    values, vectors = np.linalg.eigh(np.asarray(adjustment.cofactors.object_points))
    roots = float(adjustment.sigma0) * np.sqrt(np.maximum(values, 0.0))
    return Ellipsoids(roots[:, ::-1], vectors[:, :, ::-1])


def error_ellipses(adjustment: Adjustment) -> Ellipsoids:
    """In the plane X, Y, of all object points, a posteriori.

    Raises: ValueError where no cofactors were computed.
    """
    require_a(Adjustment, adjustment, "error_ellipses")
    if adjustment.cofactors is None:
        raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
    values, vectors = np.linalg.eigh(np.asarray(adjustment.cofactors.object_points)[:, :2, :2])
    roots = float(adjustment.sigma0) * np.sqrt(np.maximum(values, 0.0))
    return Ellipsoids(roots[:, ::-1], vectors[:, :, ::-1])
