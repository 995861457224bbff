"""The reduced normal equations of the images and the border: scaling, damping, solution, cofactors.

The border consists of unknowns shared by many images. With s = 1 / sqrt(diagonal of N), 0 for a fixed unknown,

    [ A    B ] [x_I]   [r_I]      A = s_I S_II s_I + lambda,  B = s_I S_Ib s_b,  D = s_b S_bb s_b + lambda,
    [ B^T  D ] [x_b] = [r_b]      r = s right;  lambda is 1 for a fixed unknown;  step = s x.

    A = L L^T,   Y = L^-1 B,   y = L^-1 r_I,   D - Y^T Y = M M^T
    x_b = M^-T M^-1 (r_b - Y^T y),             x_I = L^-T (y - Y x_b)

Because N has the unit diagonal after scaling, a squared pivot is the share of an unknown's normal equation that is
independent of the unknowns before it: 0 for an undetermined one, NaN from there if rounding makes it negative.

Cofactors, X = L^-T Y, Z = A^-1 in existing blocks, each scaled by s on both sides:

    Q_bb = M^-T M^-1,    Q_Ib = -X Q_bb,    Q_II = Z + X Q_bb X^T
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.normals.cholesky import inverse_factor
from jaxbundle.normals.problem import ReducedSolver


class ReducedSystem(eqx.Module):
    """The reduced normal equations without damping."""

    pairs: Float[Array, "pair d d"]
    """Blocks of the pairs i >= j of images; the last one is a dummy."""
    diagonal: Float[Array, "image d"]
    """Diagonal of N, before the elimination of the points."""
    right: Float[Array, "image d"]
    free: Bool[Array, "image d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]
    border_diagonal: Float[Array, " border"]
    """Diagonal of N, before the elimination of the points."""
    border_right: Float[Array, " border"]
    border_free: Bool[Array, " border"]


class ReducedFactor(eqx.Module):
    """A factorised system: the scale, L, Y = L^-1 B, M^-1, y = L^-1 r_I and r_b."""

    scale: Float[Array, "image d"]
    border_scale: Float[Array, " border"]
    images: Any
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]
    right: Float[Array, "image d"]
    border_right: Float[Array, " border"]
    pivots: Float[Array, "image d"]
    border_pivots: Float[Array, " border"]


class ReducedCofactors(eqx.Module):
    """Cofactors of pairs with blocks, of images and border, and of the border; 0 for fixed unknowns."""

    pairs: Float[Array, "pair d d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]


def _scale(diagonal: Array, free: Array) -> Array:
    return jnp.where(free, 1 / jnp.sqrt(jnp.where(free, diagonal, 1.0)), 0.0)


def _at_images(x: Float[Array, "image *rest"], image: Int[Array, " pair"]) -> Float[Array, "pair *rest"]:
    return x.at[image].get(mode="fill", fill_value=0.0)


def _scaled_pairs(solver: ReducedSolver, system: ReducedSystem, scale: Array, damping: Array) -> Array:
    """The scaled matrix A; unused blocks are set to 0."""
    i, j = solver.pair.T
    used = i < scale.shape[0]
    scaled = _at_images(scale, i)[:, :, None] * system.pairs * _at_images(scale, j)[:, None, :]
    added = jnp.where((used & (i == j))[:, None], _at_images(jnp.where(system.free, damping, 1.0), i), 0.0)
    d = scale.shape[1]
    return jnp.where(used[:, None, None], scaled, 0.0) + added[:, :, None] * jnp.eye(d)[None]


def factorise(solver: ReducedSolver, system: ReducedSystem, damping: Float[Array, ""]) -> ReducedFactor:
    """Factorises the system with `damping` times `diagonal` added, and its right-hand side."""
    scale = _scale(system.diagonal, system.free)
    border_scale = _scale(system.border_diagonal, system.border_free)
    factor = solver.images.factorise(_scaled_pairs(solver, system, scale, damping))
    coupling = scale[:, :, None] * system.coupling * border_scale[None, None]
    right = solver.images.forward(factor, jnp.concatenate([coupling, (scale * system.right)[..., None]], 2))
    y = right[..., :-1]
    border = border_scale[:, None] * system.border * border_scale[None]
    border = border + jnp.diag(jnp.where(system.border_free, damping, 1.0)) - jnp.einsum("idb,idc->bc", y, y)
    inverse = inverse_factor(border)
    return ReducedFactor(
        scale,
        border_scale,
        factor,
        y,
        inverse,
        right[..., -1],
        border_scale * system.border_right,
        jnp.where(system.free, solver.images.pivots(factor, *scale.shape), 1.0),
        jnp.where(system.border_free, 1 / jnp.diagonal(inverse) ** 2, 1.0),
    )


def step(solver: ReducedSolver, factor: ReducedFactor) -> tuple[Float[Array, "image d"], Float[Array, " border"]]:
    """The solution for the right-hand side of the system."""
    images, border = _finish(solver, factor, factor.right[..., None], factor.border_right[:, None])
    return images[..., 0], border[:, 0]


def solve(
    solver: ReducedSolver,
    factor: ReducedFactor,
    right: Float[Array, "image d k"],
    border_right: Float[Array, "border k"],
) -> tuple[Float[Array, "image d k"], Float[Array, "border k"]]:
    """The solution for other right-hand sides."""
    y = solver.images.forward(factor.images, factor.scale[..., None] * right)
    return _finish(solver, factor, y, factor.border_scale[:, None] * border_right)


def _finish(solver: ReducedSolver, factor: ReducedFactor, y: Array, border_right: Array) -> tuple[Array, Array]:
    remaining = border_right - jnp.einsum("idb,idk->bk", factor.coupling, y)
    border = factor.border.T @ (factor.border @ remaining)
    images = solver.images.backward(factor.images, y - factor.coupling @ border)
    return factor.scale[..., None] * images, factor.border_scale[:, None] * border


def cofactors(solver: ReducedSolver, factor: ReducedFactor) -> ReducedCofactors:
    """Cofactors of all unknowns, without the scale; not finite if the matrix is singular."""
    i, j = solver.pair.T
    scale, d = factor.scale, factor.scale.shape[1]
    z = solver.images.selected_inverse(factor.images, d)
    border = factor.border.T @ factor.border
    if border.size:
        x = solver.images.backward(factor.images, factor.coupling)
        z = z + jnp.einsum("pdb,peb->pde", _at_images(x @ border, i), _at_images(x, j))
        coupling = -scale[..., None] * (x @ border) * factor.border_scale[None, None]
    else:
        coupling = factor.coupling
    pairs = _at_images(scale, i)[:, :, None] * z * _at_images(scale, j)[:, None, :]
    return ReducedCofactors(pairs, coupling, factor.border_scale[:, None] * border * factor.border_scale[None])
