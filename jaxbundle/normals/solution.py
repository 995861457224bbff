"""N^-1 b and H^-1 b: the undamped equations solved for right-hand sides of any kind.

    [ U    W ] [t]   [b_t]        u = V^-1 b_X                               images' rows:  S t = b_t - W u
    [ W^T  V ] [X] = [b_X]        X = V^-1 (b_X - W^T t)

N = A^T P A, or with all second derivatives of v^T P v / 2, H = N + sum of w^2 v d2v, which has the same blocks. One
elimination serves all right-hand sides. Functions of the unknowns get their variances from N^-1, a free network its
S-transformation; derivatives of the adjusted unknowns take H^-1.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float

from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.eliminate import eliminate
from jaxbundle.normals.implicit import ImplicitEquations
from jaxbundle.normals.kept import KeptSums
from jaxbundle.normals.kept_vector import KeptVector, correction_of, direction_of, kept_rows
from jaxbundle.normals.partition import local_tiles
from jaxbundle.normals.point_blocks import PointFactor, backward, forward
from jaxbundle.normals.ray_products import to_images, to_points
from jaxbundle.normals.reduced_system import ReducedFactor, factorise, solve
from jaxbundle.normals.step import Linearised, linearise, partition, reduced_system
from jaxbundle.normals.substitute import image_values
from jaxbundle.normals.vector import NormalVector
from jaxbundle.numerics.devices import AXIS, device_mesh


def solve_normals(unknowns: Arranged, p: Problem, right: NormalVector, exact: bool = False) -> NormalVector:
    """N^-1 b for every vector of the leading axis, H^-1 b if `exact`; not finite where the matrix is not positive."""
    linear, free = linearise(unknowns, p, exact), p.free_tiles
    if p.devices == 1:
        return _on_device(unknowns, linear, p, free, right, None, exact)
    everywhere: Any = PartitionSpec()
    of_tiles: Any = PartitionSpec(None, None, AXIS)
    vectors = NormalVector(everywhere, everywhere, of_tiles)
    unknown_parts, linear_parts, problem_parts = partition(unknowns, linear, p)
    return jax.shard_map(
        partial(_on_device, axis=AXIS, exact=exact),
        mesh=device_mesh(p.devices),
        in_specs=(unknown_parts, linear_parts, problem_parts, PartitionSpec(None, AXIS), vectors),
        out_specs=vectors,
        check_vma=False,
    )(unknowns, linear, p, free, right)


def normal_products(unknowns: Arranged, p: Problem, b: NormalVector) -> Float[Array, "vector vector"]:
    """b^T N^-1 b of all pairs of vectors of the leading axis, on one device: no vector is substituted back.

    b^T N^-1 b = r^T S^-1 r + b_X^T V^-1 b_X,    r = b_t - W V^-1 b_X
    """
    factorised = _factorised(unknowns, linearise(unknowns, p, False), p, p.free_tiles, None, False)

    def forward_solution(b: NormalVector) -> tuple[KeptVector, KeptVector, Float[Array, "3 tile column"]]:
        u = factorised.eliminated(b.tiles)
        r = factorised.condensed(b, u)
        return r, factorised.reduced_solution(r), u

    r, t, u = lax.map(forward_solution, b)
    pairs = (r.images, t.images), (r.border, t.border), (b.tiles, u)
    parts = [jnp.einsum("fa,ga->fg", *(x.reshape(len(x), -1) for x in pair)) for pair in pairs]
    products = parts[0] + parts[1] + parts[2]
    return (products + products.T) / 2


class _Factorised(NamedTuple):
    """The equations as one device has them; `axis` names the devices, None for a single one."""

    unknowns: Arranged
    problem: Problem
    values: Float[Array, "image number"]
    turns: Float[Array, "9 3 image"]
    reduced: ReducedFactor | ImplicitEquations
    points: PointFactor
    axis: str | None
    exact: bool

    def solve(self, b: NormalVector) -> NormalVector:
        """The solution for one right-hand side."""
        p, tiles, points = self.problem, local_tiles(self.problem.tiles), self.unknowns.tiles
        o = p.observations
        t = self.reduced_solution(self.condensed(b, self.eliminated(b.tiles)))
        direction = image_values(direction_of(correction_of(t.images, t.border, p, self.unknowns), self.turns), o)
        at_points = to_points(o, self.values, direction, points, tiles, self.exact)
        return NormalVector(t.images, t.border, self.eliminated(b.tiles - at_points))

    def condensed(self, b: NormalVector, u: Float[Array, "3 tile column"]) -> KeptVector:
        """b_t - W u."""
        p, tiles = self.problem, local_tiles(self.problem.tiles)
        rows = to_images(p.observations, self.values, self.unknowns.tiles, u, tiles, self.exact)
        coupled = kept_rows(lax.psum(rows, self.axis) if self.axis else rows, self.turns, p)
        return KeptVector(b.images - coupled.images, b.border - coupled.border)

    def reduced_solution(self, right: KeptVector) -> KeptVector:
        """S^-1 r."""
        if isinstance(self.reduced, ImplicitEquations):
            return self.reduced.solve(right)
        images, border = solve(self.problem.reduced, self.reduced, right.images[..., None], right.border[:, None])
        return KeptVector(images[..., 0], border[:, 0])

    def eliminated(self, b: Float[Array, "3 tile column"]) -> Float[Array, "3 tile column"]:
        """V^-1 b."""
        return jnp.stack(backward(self.points, forward(self.points, (b[0], b[1], b[2]))))


def _factorised(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, axis: str | None, exact: bool
) -> _Factorised:
    """Eliminates the points of this device and factorises the reduced equations."""
    o, tiles, zero = p.observations, local_tiles(p.tiles), jnp.zeros(())
    rays, factors = eliminate(
        o, linear.table, unknowns.tiles, linear.prior, free, zero, tiles, p.shape, p.diagonal_pair, exact
    )
    rays = lax.psum(rays, axis) if axis else rays
    kept = _with_bends(linear, rays.rotation)
    system = reduced_system(rays, kept, p).system
    n = unknowns.tiles.shape[2]
    points = PointFactor(*(factors[:, k * n : (k + 1) * n] for k in range(6)))
    if p.shape.implicit:
        reduced = ImplicitEquations(unknowns, linear.turns, kept, system, factors, zero, p, tiles, axis, exact)
    else:
        reduced = factorise(p.reduced, system, zero)
    values = image_values(unknowns.images, o)
    return _Factorised(unknowns, p, values, linear.turns, reduced, points, axis, exact)


def _with_bends(linear: Linearised, gradient: Float[Array, "image 9"] | None) -> KeptSums:
    """What the rotations' second derivatives add, by the rays' gradient with respect to the matrices."""
    if gradient is None or linear.bends is None:
        return linear.kept
    bent = jnp.einsum("ie,eabi->iab", gradient, linear.bends)
    return linear.kept._replace(diagonal=linear.kept.diagonal.at[:, 3:6, 3:6].add(bent))


def _on_device(
    unknowns: Arranged,
    linear: Linearised,
    p: Problem,
    free: Array,
    right: NormalVector,
    axis: str | None,
    exact: bool,
) -> NormalVector:
    return lax.map(_factorised(unknowns, linear, p, free, axis, exact).solve, right)
