"""Free networks: inner constraints by an S-transformation of coordinates and cofactors (Baarda 1973).

The block is adjusted in a minimal datum first. With x0 the approximate coordinates of the points of the constraints,
the adjusted block is shifted, rotated and scaled so that

    sum (x - x0) = 0,    sum x0 x (x - x0) = 0,    sum x0 . (x - x0) = 0      the last one if the scale is free

With the columns of G (small translations, rotations and a change of scale of the whole block) and B, its rows of those
points:

    Q' = S Q S^T,    S = I - G (B^T G)^-1 B^T

for each block of Q: Q' = Q - G C^T - C G^T + G D G^T,  C = Q B M^T,  D = M B^T Q B M^T,  M = (B^T G)^-1. Among all
datums these minimise the sum of the cofactors of the points' coordinates (Meissl 1962).
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.datum_defect import transformed
from jaxbundle.block.derived import derived
from jaxbundle.block.unknowns import Unknowns, attitude_derivatives
from jaxbundle.geometry import rotation
from jaxbundle.normals.cholesky import inverse_factor
from jaxbundle.normals.cofactors import Cofactors
from jaxbundle.normals.plan.elimination_plan import EliminationPlan
from jaxbundle.normals.plan.layout import EXTERIOR
from jaxbundle.normals.problem import NormalVector, OrderedUnknowns, Problem
from jaxbundle.normals.solve_normals import solve_normals
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import is_concrete

SIMILARITY = 7


def freed(structure: Structure) -> Structure:
    """The structure of a free network for the user, without fixed elements."""
    free = structure.exterior_free.copy()
    for image, element in structure.datum.held:
        free[structure.image_names.index(image), structure.exterior_elements.index(element)] = True
    return derived(structure, exterior_free=free, datum=dataclasses.replace(structure.datum, held=()))


def carrying(structure: Structure) -> Bool[np.ndarray, " point"]:
    """Mask of the points of the inner constraints."""
    chosen = set(structure.datum.points)
    return np.array([not chosen or name in chosen for name in structure.point_names], bool)


def constrained(block: Block, adjusted: Unknowns) -> Unknowns:
    """The adjusted unknowns after the similarity transformation that fulfils the inner constraints relative to `block`.

    `block` and `adjusted` have the same origin, inside the block.

    Raises: ValueError under tracing.
    """
    if not is_concrete((block, adjusted)):
        raise ValueError("a free network cannot be adjusted inside jit, grad and vmap; use a minimal datum there")
    structure = block.structure
    points = carrying(structure)
    x0, x = np.asarray(block.object_points)[points].T, np.asarray(adjusted.points)[:, points]
    from_centre, to_centre = x.mean(1, keepdims=True), x0.mean(1, keepdims=True)
    reduced0, reduced = x0 - to_centre, x - from_centre
    left, _, right = np.linalg.svd(reduced0 @ reduced.T)
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    turned = turn @ reduced
    scale = 1.0
    if structure.datum.constraints == SIMILARITY:
        scale = float(np.sum(reduced0**2) / np.sum(reduced0 * turned))

    def moved(coordinates: Float[Array, "3 any"]) -> Float[Array, "3 any"]:
        return jnp.asarray(scale * turn @ (np.asarray(coordinates) - from_centre) + to_centre)

    matrix = rotation.product(tuple(turn.ravel()), tuple(np.asarray(adjusted.rotation)))
    return Unknowns(
        jnp.asarray(np.stack(matrix)),
        moved(adjusted.centre),
        adjusted.interior,
        adjusted.parameters,
        moved(adjusted.points),
    )


class InnerCofactors(NamedTuple):
    """Cofactors with inner constraints, in elimination order; angles are those of the corrections."""

    images: Float[Array, "image 6 6"]
    border_points: Float[Array, "kept 3 3"]
    points: Float[Array, "3 3 tile column"]


@Compiled
def _inner_cofactors(
    unknowns: OrderedUnknowns,
    p: Problem,
    carrying: Float[Array, " place"],
    images: Float[Array, "image d d"],
    border: Float[Array, "border border"],
    points: Float[Array, "3 3 tile column"],
    constraints: int,
) -> InnerCofactors:
    """Computes S Q S^T for the given blocks of Q: `images`, `border` and `points` of the minimal datum.

    `carrying`: 1 for the points of the constraints, points of the tiles first, then border points.
    """
    g = similarities(unknowns, p, constraints)
    first, chosen = p.layout.first_point, _carried(g, p, carrying)
    inverse = inverse_factor(_products(chosen, g))
    m = inverse.T @ inverse
    q = solve_normals(unknowns, p, chosen)
    d = m @ _products(chosen, q) @ m.T
    block = jax.vmap(lambda cofactors, g, c: _transformed(cofactors, g, c, m, d), (0, 1, 1))
    at = p.layout.point_rows(np.arange(p.layout.points))
    kept = border[at[:, :, None], at[:, None, :]]
    gm, cm = jnp.einsum("kl,lctn->kctn", d, g.tiles), jnp.einsum("kl,lctn->kctn", m, q.tiles)
    mixed = [[jnp.sum(g.tiles[:, a] * cm[:, b], 0) for b in range(3)] for a in range(3)]
    added = [[jnp.sum(g.tiles[:, a] * gm[:, b], 0) - mixed[a][b] - mixed[b][a] for b in range(3)] for a in range(3)]
    return InnerCofactors(
        block(images[:, :EXTERIOR, :EXTERIOR], g.images[:, :, :EXTERIOR], q.images[:, :, :EXTERIOR]),
        block(kept, _by_point(g.border, first), _by_point(q.border, first)),
        points + jnp.stack([jnp.stack(row) for row in added]),
    )


def _products(one: NormalVector, other: NormalVector) -> Float[Array, "k l"]:
    """Scalar products of the points' parts of all pairs of vectors."""
    return jnp.einsum("kb,lb->kl", one.border, other.border) + jnp.einsum("kctn,lctn->kl", one.tiles, other.tiles)


def _transformed(
    cofactors: Float[Array, "r r"], g: Float[Array, "k r"], q: Float[Array, "k r"], m: Array, d: Array
) -> Float[Array, "r r"]:
    """The transformation Q - G C^T - C G^T + G D G^T of one block."""
    mixed = g.T @ m @ q
    return cofactors - mixed - mixed.T + g.T @ d @ g


def _carried(g: NormalVector, p: Problem, carrying: Float[Array, " place"]) -> NormalVector:
    """The matrix B: the rows of G of the points of the constraints."""
    tiles = g.tiles.shape[2:]
    places = tiles[0] * tiles[1]
    at_border = _border(carrying[places:], p.layout.first_point)
    at_tiles = carrying[:places].reshape(1, 1, *tiles)
    return NormalVector(jnp.zeros_like(g.images), g.border * at_border[None], g.tiles * at_tiles)


def _border(of_points: Float[Array, " kept"], first: int) -> Float[Array, " border"]:
    """Numbers of the border points, repeated on the rows of their coordinates; 0 for earlier rows."""
    return jnp.concatenate([jnp.zeros(first), jnp.repeat(of_points, 3)])


def _by_point(border: Float[Array, "k border"], first: int) -> Float[Array, "k kept 3"]:
    return border[:, first:].reshape(len(border), (border.shape[1] - first) // 3, 3)


def similarities(unknowns: OrderedUnknowns, p: Problem, constraints: int) -> NormalVector:
    """The matrix G: corrections for small translations, rotations and, with 7 constraints, a change of scale.

    Lengths are in units of the spread of the images, so that all columns have similar magnitudes.
    """
    images = unknowns.images
    radius = jnp.sqrt(jnp.mean(jnp.sum(images.centre**2, 0)))
    turns = attitude_derivatives(images.rotation, p.observations.in_angles, p.observations.system)

    def moved(parameters: Float[Array, "7"]) -> tuple[Array, Array, Array, Array]:
        kept = transformed(images, parameters, radius)
        flat = Unknowns(
            images.rotation, images.centre, images.interior, images.parameters, unknowns.tiles.reshape(3, -1)
        )
        return kept.centre, kept.rotation, kept.points, transformed(flat, parameters, radius).points

    centre, turned, kept, tiles = jax.jacfwd(moved)(jnp.zeros(SIMILARITY))
    # the columns of a rotation's derivatives by three angles about its own axes are orthogonal, of squared length 2
    angles = jnp.einsum("eai,eik->aik", turns, turned) / jnp.sum(turns**2, 0)[..., None]
    exterior = jnp.concatenate([centre, angles]).transpose(2, 1, 0)[:constraints]
    own = jnp.zeros((constraints, exterior.shape[1], p.layout.image - EXTERIOR))
    border = kept.transpose(2, 1, 0)[:constraints].reshape(constraints, -1)
    return NormalVector(
        jnp.concatenate([exterior, own], 2),
        jnp.concatenate([jnp.zeros((constraints, p.layout.first_point)), border], 1),
        tiles.transpose(2, 0, 1)[:constraints].reshape(constraints, *unknowns.tiles.shape),
    )


def with_inner_constraints(
    unknowns: OrderedUnknowns, p: Problem, carrying: Float[Array, " place"], constraints: int, rows: NormalVector
) -> NormalVector:
    """Computes S^T f for each row f: with Q of the minimal datum, f Q f^T is then that of the inner constraints."""
    g = similarities(unknowns, p, constraints)
    chosen = _carried(g, p, carrying)
    inverse = inverse_factor(_products(chosen, g))
    m = inverse.T @ inverse
    whole = jnp.einsum("fia,kia->fk", rows.images, g.images) + _products(rows, g)
    return jax.tree.map(lambda f, b: f - jnp.einsum("fk,k...->f...", whole @ m, b), rows, chosen)


def carrying_places(structure: Structure, plan: EliminationPlan) -> Float[np.ndarray, " place"]:
    """Vector with 1 for the points of the constraints, points of the tiles first, then border points."""
    places = np.zeros(plan.order.points)
    places[plan.order.point[carrying(structure)]] = 1.0
    return places


def inner_cofactors_of(
    structure: Structure, plan: EliminationPlan, unknowns: OrderedUnknowns, p: Problem, q: Cofactors, optimised: bool
) -> InnerCofactors:
    """The cofactors of a free network from those of its minimal datum."""
    constraints = structure.datum.constraints
    return _inner_cofactors(
        unknowns, p, carrying_places(structure, plan), q.images, q.border, q.points, constraints, optimised=optimised
    )
