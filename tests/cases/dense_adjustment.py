"""The adjustment without elimination: one dense design matrix by forward-mode autodiff, solved by QR.

Everything stands in one vector of the free corrections: exterior, then interior by column, then object points.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.block.residuals import Observations, observations_of, weighted_residuals
from jaxbundle.block.unknowns import Correction, Unknowns, corrected, unknowns_of
from jaxbundle.geometry import rotation
from jaxbundle.numerics.compilation import QUICKLY


class System(NamedTuple):
    """Design matrix A and residuals v, both weighted."""

    design: Float[np.ndarray, "observation free"]
    residuals: Float[np.ndarray, " observation"]

    @property
    def lengths(self) -> Float[np.ndarray, " free"]:
        """Square roots of diag N."""
        return np.linalg.norm(self.design, axis=0)


def centred(block: Block) -> tuple[Unknowns, Observations]:
    """Unknowns and observations of a block moved to the centre of its images."""
    block = block.moved(-jnp.mean(block.exterior.projection_centre, 0))
    return unknowns_of(block), observations_of(block)


Masks = tuple[np.ndarray, ...]


def masks(o: Observations) -> Masks:
    """What is free: exterior, interior by column, parameters, object points."""
    return tuple(map(np.asarray, (o.exterior_free, o.interior_free, o.parameter_free, o.point_free)))


def moved(unknowns: Unknowns, o: Observations, d: Float[Array, " free"], free: Masks | None = None) -> Unknowns:
    """The unknowns after a correction of the free elements; `free`: the masks of observations that are traced."""
    fields, first = [], 0
    for mask in masks(o) if free is None else free:
        fields.append(jnp.zeros(mask.shape).at[mask].set(d[first : first + mask.sum()]))
        first += int(mask.sum())
    exterior, by_column, parameters, points = fields
    interior = jnp.zeros_like(unknowns.interior).at[np.array(o.columns, int)].set(by_column)
    return corrected(unknowns, Correction(exterior, interior, parameters, points), o.in_angles, o.system)


def difference(unknowns: Unknowns, again: Unknowns, o: Observations) -> Float[np.ndarray, " free"]:
    """The correction that leads from `unknowns` to `again`."""
    turn = rotation.product(rotation.transpose(tuple(unknowns.rotation)), tuple(again.rotation))
    small = jnp.stack(rotation.to_alpha_omega_kappa(turn))
    old, new = (jnp.stack(o.system.angles_from_rotation(tuple(u.rotation))) for u in (unknowns, again))
    own = jnp.arctan2(jnp.sin(new - old), jnp.cos(new - old))
    angles = small if o.in_angles is None else jnp.where(o.in_angles, own, small)
    moved = (again.interior - unknowns.interior, again.parameters - unknowns.parameters, again.points - unknowns.points)
    return free_values(again.centre - unknowns.centre, angles, *moved, o)


def sizes(unknowns: Unknowns, o: Observations) -> Float[np.ndarray, " free"]:
    """Absolute values of the unknowns; 1 for angles."""
    angles = jnp.ones_like(unknowns.centre)
    return np.abs(free_values(unknowns.centre, angles, unknowns.interior, unknowns.parameters, unknowns.points, o))


def free_values(
    centre: Array, angles: Array, interior: Array, parameters: Array, points: Array, o: Observations
) -> Float[np.ndarray, " free"]:
    """The vector of what is free."""
    fields = jnp.concatenate([centre, angles]), interior[np.array(o.columns, int)], parameters, points
    return np.concatenate([np.asarray(field)[mask] for field, mask in zip(fields, masks(o), strict=True)])


def free_count(o: Observations) -> int:
    """N: number of unknown elements."""
    return sum(int(mask.sum()) for mask in masks(o))


def residual_vector(
    unknowns: Unknowns, o: Observations, d: Float[Array, " free"], free: Masks | None = None
) -> Float[Array, " observation"]:
    """Weighted residuals of all observations after a correction."""
    return jnp.concatenate([v.ravel() for v in weighted_residuals(moved(unknowns, o, d, free), o)])


Forms = tuple[tuple[tuple[int, ...], bytes], ...]  # of masks, as static arguments


def _forms(o: Observations) -> Forms:
    return tuple((mask.shape, mask.tobytes()) for mask in masks(o))


def _masks(forms: Forms) -> Masks:
    return tuple(np.frombuffer(values, bool).reshape(shape) for shape, values in forms)


@partial(jax.jit, static_argnames="forms", compiler_options=QUICKLY)
def _linearised(zero: Float[Array, " free"], unknowns: Unknowns, o: Observations, forms: Forms) -> tuple[Array, Array]:
    v, linear = jax.linearize(lambda d: residual_vector(unknowns, o, d, _masks(forms)), zero)
    return jax.vmap(linear, out_axes=1)(jnp.eye(len(zero))), v


def dense_system(unknowns: Unknowns, o: Observations) -> System:
    """Design matrix and residuals at the unknowns; values are arguments, so that blocks of one form share a program."""
    design, v = _linearised(jnp.zeros(free_count(o)), unknowns, o, _forms(o))
    return System(np.asarray(design), np.asarray(v))


@partial(jax.jit, static_argnames="forms", compiler_options=QUICKLY)
def _curved(d: Float[Array, " free"], unknowns: Unknowns, o: Observations, forms: Forms) -> Float[Array, " free"]:
    def cost(e: Float[Array, " free"]) -> Array:
        return 0.5 * jnp.sum(residual_vector(unknowns, o, e, _masks(forms)) ** 2)

    return jax.jvp(jax.grad(cost), (jnp.zeros_like(d),), (d,))[1]


def hessian_product(unknowns: Unknowns, o: Observations, d: Float[np.ndarray, " free"]) -> Float[np.ndarray, " free"]:
    """H d, with all second derivatives of v^T P v / 2 by the free corrections."""
    return np.asarray(_curved(jnp.asarray(d), unknowns, o, _forms(o)))


def dense_step(system: System, damping: float) -> Float[np.ndarray, " free"]:
    """d of (N + lambda diag N) d = -A^T v, from the QR decomposition of A above sqrt(lambda diag N)."""
    lengths = system.lengths
    upper = np.concatenate([system.design / lengths, np.sqrt(damping) * np.eye(len(lengths))])
    q, r = np.linalg.qr(upper)
    return -np.linalg.solve(r, q[: len(system.residuals)].T @ system.residuals) / lengths


def dense_cofactors(unknowns: Unknowns, o: Observations) -> Float[np.ndarray, "free free"]:
    """N^-1, the attitudes in the user's angles."""
    in_angles = jnp.ones(o.image_camera.shape, bool)
    in_user_angles = eqx.tree_at(lambda o: o.in_angles, o, in_angles, is_leaf=lambda leaf: leaf is None)
    system = dense_system(unknowns, in_user_angles)
    inverse = np.linalg.inv(np.linalg.qr(system.design / system.lengths, mode="r")) / system.lengths[:, None]
    return inverse @ inverse.T
