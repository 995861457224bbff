"""Making the result from the solver's unknowns: residuals, angles and cofactors in the order of the block.

Compiled programs compute in the padded elimination order, so one program is valid for many blocks; the host restores
the order of the block.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.datum_precision import weak_datum
from jaxbundle.block.unknowns import angle_derivatives, angles_near
from jaxbundle.normals.cofactors import Cofactors, cofactors
from jaxbundle.normals.cost import ray_arrays, rounding_noise, weighted_residuals
from jaxbundle.normals.from_block import rays_to_block_order, spread, to_block_order
from jaxbundle.normals.inspection import Inspection, inspection
from jaxbundle.normals.plan.elimination_plan import EliminationPlan
from jaxbundle.normals.plan.layout import EXTERIOR
from jaxbundle.normals.problem import OrderedUnknowns, Problem
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import constant, on_device, on_host, on_host_or_traced, product
from jaxbundle.solve.adjustment import Adjustment, BlockCofactors, Iterations, Status
from jaxbundle.solve.free_network import InnerCofactors, inner_cofactors_of
from jaxbundle.solve.implicit_precision import with_derivatives
from jaxbundle.solve.levenberg_marquardt import FLAT, is_flat
from jaxbundle.solve.options import Options
from jaxbundle.solve.undetermined import End, Undetermined, undetermined


class Answer(NamedTuple):
    """Final values in elimination order; cofactors are None without standard deviations."""

    angles: Float[Array, "3 image"]
    residuals: list[Array]
    noise: Float[Array, ""]  # v^T P v / 2 of rounding errors
    inspection: Inspection | None
    cofactors: Cofactors | None
    to_user: (
        Float[Array, "image 6 6"] | None
    )  # derivatives of the user's angles with respect to those of the corrections


class Ended(NamedTuple):
    """The end of a solve and the requested values.

    `inspected`: whether convergence and undetermined unknowns are checked without standard deviations.
    `differentiable`: whether values are traced by jit, grad or vmap; then nothing is checked.
    """

    iterations: Iterations
    origin: Float[Array | np.ndarray, "3"]
    options: Options
    precision: bool
    inspected: bool
    differentiable: bool
    optimised: bool


@Compiled
def _answer(
    arranged: OrderedUnknowns, problem: Problem, reference: Float[Array, "3 image"], precision: bool, inspected: bool
) -> Answer:
    """Computes angles near the reference, weighted residuals, and cofactors (in the user's angles)."""
    o, matrix = problem.observations, arranged.images.rotation
    angles = jnp.stack(angles_near(tuple(matrix), reference, o.system))
    residuals = weighted_residuals(arranged, problem)
    noise = rounding_noise(problem)
    if not precision:
        found = inspection(arranged, problem) if inspected else None
        return Answer(angles, residuals, noise, found, None, None)
    q = cofactors(*constant((arranged, problem)))
    turned = angle_derivatives(matrix, o.in_angles, reference, o.system).transpose(2, 0, 1)
    to_user = jnp.zeros((matrix.shape[1], 6, 6)).at[:, :3, :3].set(jnp.eye(3)).at[:, 3:, 3:].set(turned)
    return Answer(angles, residuals, noise, q.inspection, q, to_user)


def adjustment(
    block: Block,
    plan: EliminationPlan,
    problem: Problem,
    arranged: OrderedUnknowns,
    ended: Ended,
) -> Adjustment:
    """Makes the adjustment of a block. `problem` and `arranged` have the origin `ended.origin`."""
    optimised, iterations = ended.optimised, ended.iterations
    reference = spread(on_host(block.exterior.angles).T, plan.order.image, plan.order.images, 0.0)
    inspected = ended.inspected and not ended.differentiable
    answer = _answer(arranged, problem, reference, ended.precision, inspected, optimised=optimised)
    weighted = _tables(block, plan, problem, answer.residuals)
    blocks, redundancy_numbers = None, None
    if answer.cofactors is not None:
        if ended.differentiable:
            q = with_derivatives(answer.cofactors, arranged, problem, plan, block.structure, optimised)
            answer = answer._replace(cofactors=q)
        inner = None
        if block.structure.datum.kind == "inner":
            inner = inner_cofactors_of(block.structure, plan, arranged, problem, answer.cofactors, optimised)
        blocks = _cofactors(block, plan, answer, inner)
        redundancy_numbers = _redundancy_numbers(block, _tables(block, plan, problem, answer.cofactors.leverages))
    adjusted = _adjusted(block, plan, arranged, answer.angles, ended.origin)
    loose, weak = Undetermined(), ()
    if answer.inspection is not None and not ended.differentiable:
        iterations = certified(iterations, answer.inspection, answer.noise)
        converged = int(iterations.status) == Status.CONVERGED
        end = End(adjusted, plan, problem, arranged, np.asarray(ended.origin))
        loose = undetermined(end, answer.inspection, converged)
        sigma0 = np.sqrt(2 * float(iterations.final_cost) / max(adjusted.redundancy + loose.directions, 1))
        at_end = int(iterations.status) in (
            Status.CONVERGED,
            Status.CREEPING,
        )  # in other cases the dimensions of the block are not relevant
        weak = weak_datum(adjusted, float(sigma0)) if at_end and not loose.findings else ()
    return Adjustment(
        adjusted,
        _unweighted(block, weighted),
        weighted,
        blocks,
        redundancy_numbers,
        iterations,
        ended.options,
        plan.method,
        (*block.structure.findings, *loose.findings, *weak),
        undetermined_directions=loose.directions,
    )


def certified(iterations: Iterations, found: Inspection, noise: Float[Array, ""]) -> Iterations:
    """The iterations, with the status "stalled" if they converged but the gradient does not vanish."""
    if int(iterations.status) != Status.CONVERGED:
        return iterations
    tolerance = max(FLAT, float(iterations.step))
    if bool(is_flat(found.steepness, iterations.final_cost, noise, tolerance)):
        return iterations
    return iterations._replace(status=on_device(int(Status.STALLED)))


def _tables(block: Block, plan: EliminationPlan, problem: Problem, parts: list[Array]) -> tuple[Array, ...]:
    """Values of the observations, as one table for the rays and for each group; 0 where not observed."""
    of_rays = ray_arrays(problem)
    rays = rays_to_block_order(plan, problem.observations.model.components, parts[:of_rays])
    return rays, *_members(parts[of_rays:], [len(group.structure.indices) for group in block.groups])


@on_host_or_traced
def _members(_xp: Any, values: list, counts: list[int]) -> list:
    """Values of the members of each group, without its padding."""
    return [v.T[:count] for v, count in zip(values, counts, strict=True)]


def _unweighted(block: Block, weighted: tuple[Array, ...]) -> tuple[Array, ...]:
    """Residuals in the units of their observations."""
    groups = zip(block.groups, weighted[1:], strict=True)
    return product(weighted[0], block.rays.sigmas), *(group.unweighted(v) for group, v in groups)


def _redundancy_numbers(block: Block, leverages: tuple[Array, ...]) -> tuple[Array, ...]:
    observed = np.ones(leverages[0].shape, bool), *(group.structure.observed for group in block.groups)
    return tuple(_redundant(o, h) for o, h in zip(observed, leverages, strict=True))


@on_host_or_traced
def _redundant(xp: Any, observed: Any, leverages: Any) -> Any:
    """Redundancy numbers r = 1 - h; 0 where not observed."""
    return xp.where(observed, xp.subtract(1, leverages), 0.0)


def _adjusted(
    block: Block,
    plan: EliminationPlan,
    arranged: OrderedUnknowns,
    angles: Float[Array, "3 image"],
    origin: Float[Array | np.ndarray, "3"],
) -> Block:
    """The block with its adjusted values. Fixed elements are copied from the input, as shifts of the origin round."""

    def values(b: Block) -> tuple:
        exterior = b.exterior.projection_centre, b.exterior.angles
        return b.object_points, *exterior, b.interior.elements, b.parameters

    new = to_block_order(plan, arranged), angles, plan.order.image
    return eqx.tree_at(values, block, _new_values(block.structure, values(block), new, origin))


@on_host_or_traced
def _new_values(xp: Any, structure: Structure, old: tuple, new: tuple, origin: Any) -> tuple:
    """`old`, and the returned ones: values of the block; `new`: unknowns, angles, and the column of each image."""
    (points, centre, old_angles, interior, _), (unknowns, angles, image) = old, new
    free = structure.exterior_free
    return (
        xp.where(structure.point_free, unknowns.points.T + origin[None], points),
        xp.where(free[:, :3], unknowns.centre.T + origin[None], centre),
        xp.where(free[:, 3:], angles.T[image], old_angles),
        unknowns.interior[: interior.shape[1]].T,
        unknowns.parameters,
    )


def _cofactors(block: Block, plan: EliminationPlan, answer: Answer, inner: InnerCofactors | None) -> BlockCofactors:
    """Cofactors in the order of the block; `inner`: cofactors of a free network instead of its minimal datum."""
    size = len(block.structure.cameras), block.interior.elements.shape[1], block.structure.interior_columns
    return BlockCofactors(*_blocks(plan, size, answer.cofactors, inner, answer.to_user))


@on_host_or_traced
def _blocks(
    xp: Any,
    plan: EliminationPlan,
    size: tuple[int, int, tuple[int, ...]],
    q: Cofactors,
    inner: InnerCofactors | None,
    to_user: Any,
) -> tuple:
    """`size`: numbers of cameras and of their elements, and the columns of the free elements."""
    layout, (cameras, elements, interior_columns) = plan.layout, size
    small = (inner.images if inner else q.images[:, :EXTERIOR, :EXTERIOR])[plan.order.image]
    to_user = to_user[plan.order.image]
    exterior = to_user @ small @ to_user.transpose(0, 2, 1)

    columns, count = np.array(interior_columns, int), len(interior_columns)
    border = q.border
    if layout.own_cameras:
        own = q.images[plan.order.camera][:, EXTERIOR:, EXTERIOR:]
    else:
        at = layout.camera_rows(np.arange(cameras))
        own = border[at[:, :, None], at[:, None, :]]
    place = np.zeros((elements, count))
    place[columns, np.arange(count)] = 1.0
    interior = place @ own @ place.T

    at = layout.point_rows(np.arange(layout.points))
    of_border = border[at[:, :, None], at[:, None, :]]
    inside = slice(layout.first_parameter, layout.first_parameter + plan.order.parameters)
    eliminated = q.points
    if inner:
        of_border, eliminated = inner.border_points, inner.points
    eliminated = eliminated.transpose(2, 3, 0, 1).reshape(-1, 3, 3)
    points = xp.concatenate([eliminated, of_border])[plan.order.point]
    return exterior, interior, points, border[inside, inside]
